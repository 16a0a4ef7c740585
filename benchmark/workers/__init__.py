"""Isolated worker processes, their restart policy, and the services that answer in them."""

from eitbench.benchmark.workers.restarting import RestartingWorker
from eitbench.benchmark.workers.worker import Reply, Worker, WorkerLostError

__all__ = ["Reply", "RestartingWorker", "Worker", "WorkerLostError"]
