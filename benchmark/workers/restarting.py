"""The restart policy of workers: a lost worker is replaced a few times.

Runs, checks and tuning ask their workers through it.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eitbench.benchmark.workers.messages import Failure, Reply, WorkerLostError
from eitbench.benchmark.workers.worker import Worker, serve

RESTARTS = 3


class SetUpFailedError(WorkerLostError):
    """The service refused to be set up: its `set_up` raised an error."""


@dataclass
class WorkerHistory:
    """Losses of the workers of one service; plain values that can be stored.

    Attributes:
        restarts: number of lost workers that were replaced.
        losses: number of requests that cost a worker, or that no worker was left for.
        lost: failure of the last worker that was lost.
    """

    restarts: int = 0
    losses: int = 0
    lost: Failure | None = None


class RestartingWorker:
    """A worker for a service, which is set up in it; started when needed, replaced when lost.

    Attributes:
        history: losses so far.
        memory_mb: peak resident memory of all its workers [MiB].
    """

    def __init__(
        self,
        service: object,
        *,
        set_up_limit_s: float,
        history: WorkerHistory | None = None,
        **options: Any,
    ) -> None:
        """Prepare a worker for `service`; no process is started yet.

        Args:
            set_up_limit_s: seconds that `service.set_up()` may take.
            history: losses of an earlier process that this one continues.
            options: `log`, `stop`, `memory_limit_mb`, `core` and `confinement` of `Worker`.
        """
        self.history = history or WorkerHistory()
        self.memory_mb = float("nan")
        self._service, self._set_up_limit_s, self._options = service, set_up_limit_s, options
        self._worker: Worker | None = None

    @property
    def running(self) -> bool:
        """True if there is a worker."""
        return self._worker is not None

    def start(self) -> Reply:
        """End the worker, if there is one, and set the service up in a new one.

        Raises:
            WorkerLostError: the service cannot be set up.
            StoppedError: the run was interrupted.
        """
        self.close()
        self._worker = Worker(serve, self._service, **self._options)
        try:
            reply = self._ask("set_up", limit=self._set_up_limit_s, what="set-up")
            if reply.failure is not None:
                raise SetUpFailedError(reply.failure)
        except WorkerLostError as lost:
            self.close()
            # Another time would not help.
            self.history.restarts, self.history.lost = RESTARTS, lost.failure
            raise
        return reply

    def ask(self, *request: object, limit: float, what: str) -> Reply:
        """Ask the worker, or a new one if there is none; see `Worker.ask`.

        Raises:
            WorkerLostError: the worker is lost, or was lost before and cannot be replaced.
            StoppedError: the run was interrupted.
        """
        if self._worker is None:
            self._replace()
        try:
            return self._ask(*request, limit=limit, what=what)
        except WorkerLostError as lost:
            self.history.lost = lost.failure
            self.history.losses += 1
            self.close()
            raise

    def _replace(self) -> None:
        history = self.history
        if history.lost is not None:
            if history.restarts >= RESTARTS:
                history.losses += 1
                message = f"not tried, as its process was lost too often: {history.lost.message}"
                raise WorkerLostError(replace(history.lost, message=message))
            history.restarts += 1
        self.start()

    def _ask(self, *request: object, limit: float, what: str) -> Reply:
        assert self._worker is not None
        reply = self._worker.ask(*request, limit=limit, what=what)
        self.memory_mb = float(np.fmax(self.memory_mb, reply.memory_mb))
        return reply

    def close(self) -> None:
        """End the worker and every process it started."""
        if self._worker is not None:
            self._worker.close()
            self._worker = None
