"""Isolated worker processes, their restart policy, and the services that answer in them."""

from eitbench.benchmark.workers.restarting import RestartingWorker
from eitbench.benchmark.workers.worker import (
    Failure,
    Reply,
    StoppedError,
    Worker,
    WorkerLostError,
    plugin_names,
    serve,
)

__all__ = [
    "Failure",
    "Reply",
    "RestartingWorker",
    "StoppedError",
    "Worker",
    "WorkerLostError",
    "plugin_names",
    "serve",
]
