"""Asking a method or operator for all samples of a cell, batch by batch, whatever it does.

What is answered is kept at once, with what the cell has to remember: a run that is killed at any
moment and resumed has the rows that it would have had.
"""

import json
import threading
import time
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from eitbench.benchmark.run.cell_task import NAN, CellTask
from eitbench.benchmark.run.outcome import Outcome
from eitbench.benchmark.run.progress import Bar
from eitbench.benchmark.workers.worker import (
    Failure,
    Reply,
    StoppedError,
    Worker,
    WorkerLostError,
    describe_exception,
    serve,
)
from eitbench.scenarios.errors import DataCorruptError, EitbenchError

RESTARTS = 3
TELL_LIMIT_S = 60.0
SAVE_SECONDS = 1.0  # samples that are asked for one by one are kept as often as this
# Failures that asking again sample by sample would not mend.
BROKEN_CONTRACT = frozenset({"mutated", "shape", "dtype"})


@dataclass
class CellState:
    """What a cell remembers beside its rows.

    Attributes:
        row: figures of the cell from its set-up and its first sample.
        failure: why nothing more is asked for, if so.
        working: whether there is a worker.
        restarts, losses: how many workers were started again, and how many were lost.
        lost: why the last one was.
        first_lost: why the first sample alone cost one, if so.
        alone: whether samples are asked for one by one from the start.
        suspected: number of losses when a whole batch cost a worker and its samples are tried.
        done, seconds: samples answered in whole batches, and the time that took.
    """

    row: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None
    working: bool = False
    restarts: int = 0
    losses: int = 0
    lost: Failure | None = None
    first_lost: Failure | None = None
    alone: bool = False
    suspected: int | None = None
    done: int = 0
    seconds: float = 0.0


_STATE = TypeAdapter(CellState)


class CellRun:
    """Runs what is not kept yet of one cell.

    Attributes:
        pending: the batches that are not kept yet, or not whole.
    """

    def __init__(self, task: CellTask, progress: Bar, stop: threading.Event) -> None:
        self.task, self.progress, self.stop = task, progress, stop
        self.plan, self.store = task.plan, task.store
        self.memory_mb = NAN
        self._worker: Worker | None = None
        batches = [
            (split, slice(start, min(start + self.plan.batch, size)))
            for split, size in task.sizes.items()
            for start in range(0, size, self.plan.batch)
        ]
        kept = [self.store.batch_length(self.plan.cell, s, rows.start) for s, rows in batches]
        self._kept = sum(kept)
        self.pending = [
            (split, rows)
            for (split, rows), count in zip(batches, kept, strict=True)
            if count < rows.stop - rows.start
        ]
        self._begun = bool(self._kept)
        self._state = CellState()
        if self._begun:
            split, rows = batches[np.flatnonzero(kept)[-1]]
            self._state = _remembered(self.store.batch(self.plan.cell, split, rows.start).state)

    def run(self) -> dict[str, Any]:
        """Do the outstanding batches and return figures of the cell as a whole.

        Raises:
            StoppedError: the run was interrupted; finished batches are kept.
            EitbenchError: what is kept could not be written or read.
        """
        state = self._state
        self.progress.advance(self._kept)
        measured: dict[str, Any] = {}
        try:
            if state.failure is not None:
                raise WorkerLostError(state.failure)
            if not self._begun:
                ready = self._set_up()
                state.row = {**ready.value, "setup_s": ready.seconds}
                state.row["first_frame_ms"] = self._first()
            elif state.working:
                self._set_up()
            self._batches()
            measured = self.task.warm(lambda what, rows: self._answer("test", rows, what))
            measured |= self._prior_knowledge()
        except WorkerLostError as lost:
            state.failure = lost.failure
        except (StoppedError, EitbenchError):
            raise
        except Exception as error:  # whatever else goes wrong here is this cell's affair
            state.failure = describe_exception(error)
        finally:
            self._close()
        if state.failure is not None:
            for split, rows in self.pending:
                outcome = self._kept_of(split, rows)
                self._keep(split, rows, outcome.fail(_missing(rows, outcome), state.failure))
        fps = state.done / state.seconds if state.seconds > 0 else NAN
        return state.row | measured | {"batch_fps": fps, "memory_mb": self.memory_mb}

    def _set_up(self) -> Reply:
        """Start a worker and make the task ready in it.

        Raises:
            WorkerLostError: that fails.
        """
        self._worker = Worker(
            serve,
            self.task.service(),
            log=self.store.log(self.plan.cell),
            stop=self.stop,
            memory_limit_mb=self.plan.memory_limit_mb,
        )
        reply = self._ask("set_up", limit=self.plan.fit_limit_s, what="set-up")
        if reply.failure is not None:
            raise WorkerLostError(reply.failure)
        return reply

    def _set_up_again(self) -> None:
        """Go on with a new worker, a few times in a cell.

        Raises:
            WorkerLostError: not again.
        """
        state = self._state
        reason = state.lost or Failure("error", "its process was lost")
        if state.restarts >= RESTARTS:
            state.losses += 1
            message = f"not tried after too many losses: {reason.message}"
            raise WorkerLostError(replace(reason, message=message))
        state.restarts += 1
        try:
            self._set_up()
        except WorkerLostError as lost:
            self._close()
            state.restarts, state.lost = RESTARTS, lost.failure  # another time would not help
            raise

    def _first(self) -> float:
        """Time of the first sample that a task sees [ms]."""
        try:
            first = self._answer("test", slice(0, 1), "the first frame")
        except WorkerLostError as lost:
            self._state.first_lost = lost.failure
            return NAN
        return NAN if first.failure else first.seconds * 1e3

    def _prior_knowledge(self) -> dict[str, Any]:
        """What the task was told, if it says so and is still there."""
        if self._worker is None or not self.task.tells:
            return {}
        reply = self._ask("prior_knowledge", limit=TELL_LIMIT_S, what="its account of what it read")
        return {} if reply.failure is not None else self.task.prior_knowledge(reply.value)

    def _batches(self) -> None:
        """Keep the answers to the pending batches, each leaving the list."""
        while self.pending:
            split, rows = self.pending[0]
            outcome = self._kept_of(split, rows)
            if len(outcome):
                self._one_by_one(split, rows, outcome)
            elif (split, rows.start) == ("test", 0) and self._state.first_lost is not None:
                self._one_by_one(split, rows, outcome.fail(1, self._state.first_lost))
            elif self._state.alone or not self._together(split, rows, outcome):
                self._one_by_one(split, rows, outcome)
            self._keep(split, rows, outcome)
            self.pending.pop(0)

    def _together(self, split: str, rows: slice, outcome: Outcome) -> bool:
        """Ask for a whole batch; False where its samples have to be asked for one by one."""
        state, n = self._state, rows.stop - rows.start
        try:
            reply = self._answer(split, rows, f"a batch of {n} frames")
        except WorkerLostError:
            state.suspected = state.losses
            return False
        if reply.failure is None:
            state.done, state.seconds = state.done + n, state.seconds + reply.seconds
            outcome.add(*self.task.values(split, rows, reply))
            return True
        if BROKEN_CONTRACT.intersection(reply.failure.kinds):
            outcome.fail(n, reply.failure)
            return True
        return False

    def _one_by_one(self, split: str, rows: slice, outcome: Outcome) -> None:
        """Ask sample by sample for what is missing of a batch, so that only bad ones are lost."""
        state, saved = self._state, time.monotonic()
        for k in range(rows.start + len(outcome), rows.stop):
            if time.monotonic() - saved > SAVE_SECONDS:
                self._save(split, rows, outcome)
                saved = time.monotonic()
            row = slice(k, k + 1)
            try:
                reply = self._answer(split, row, "a frame")
            except WorkerLostError as lost:
                outcome.fail(1, lost.failure)
                continue
            if reply.failure is None:
                outcome.add(*self.task.values(split, row, reply))
            else:
                outcome.fail(1, reply.failure)
        # Where no sample was to blame the batch was: the next would cost a worker as well.
        state.alone = state.alone or state.suspected == state.losses
        state.suspected = None

    def _answer(self, split: str, rows: slice, what: str) -> Reply:
        """Ask the worker, or a new one if the last was lost.

        Raises:
            WorkerLostError: the worker is lost, or was and cannot be replaced.
        """
        if self._worker is None:
            self._set_up_again()
        limit = self.plan.frame_limit_s * (rows.stop - rows.start)
        try:
            return self._ask(*self.task.request(split, rows), limit=limit, what=what)
        except WorkerLostError as lost:
            self._state.lost = lost.failure
            self._state.losses += 1
            self._close()
            raise

    def _ask(self, *request: object, limit: float, what: str) -> Reply:
        assert self._worker is not None
        reply = self._worker.ask(*request, limit=limit, what=what)
        self.memory_mb = float(np.fmax(self.memory_mb, reply.memory_mb))
        return reply

    def _close(self) -> None:
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def _kept_of(self, split: str, rows: slice) -> Outcome:
        """What is kept of a batch already."""
        cell, outcome = self.plan.cell, Outcome(self.task.blank)
        if self.store.batch_length(cell, split, rows.start):
            outcome.take(self.store.batch(cell, split, rows.start))
        return outcome

    def _save(self, split: str, rows: slice, outcome: Outcome) -> None:
        self._state.working = self._worker is not None
        batch = outcome.batch(rows.start, json.dumps(asdict(self._state)))
        self.store.save_batch(self.plan.cell, split, batch)

    def _keep(self, split: str, rows: slice, outcome: Outcome) -> None:
        before = self.store.batch_length(self.plan.cell, split, rows.start)
        self._save(split, rows, outcome)
        self.progress.advance(rows.stop - rows.start - before)


def _missing(rows: slice, outcome: Outcome) -> int:
    return int(rows.stop - rows.start) - len(outcome)


def _remembered(text: str) -> CellState:
    """What was written with the last batch that is kept.

    Raises:
        DataCorruptError: it is not that.
    """
    try:
        return _STATE.validate_python(json.loads(text))
    except ValueError as error:
        raise DataCorruptError(
            "A part of the run does not say where its cell stood: start a new run."
        ) from error
