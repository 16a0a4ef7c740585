"""One cell of a run: one method or operator on one scenario, in a worker, batch by batch."""

import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.outcome import Kept, Outcome
from eitbench.benchmark.progress import CellProgress
from eitbench.benchmark.subject import NAN, Judged, Subject
from eitbench.benchmark.worker import (
    Failure,
    Reply,
    StoppedError,
    Worker,
    WorkerLostError,
    describe_exception,
    serve,
)
from eitbench.scenarios.errors import EitbenchError

RESTARTS = 3
TELL_LIMIT_S = 60.0
# Failures that asking again sample by sample would not mend.
BROKEN_CONTRACT = frozenset({"mutated", "shape", "dtype"})


def run_cell(subject: Judged, progress: CellProgress, stop: threading.Event) -> None:
    """Ask for what is not kept yet, then judge the cell; whatever it does is a row.

    Raises:
        StoppedError: the run was interrupted; finished batches are kept.
        EitbenchError: what is kept could not be written or read.
    """
    judge_cell(subject, CellRun(subject, progress, stop).run())
    if subject.plan.cell.variant:  # of other tracks figures are kept, no images
        subject.store.forget_answers(subject.plan.cell)


def prepare(subject: Subject, progress: CellProgress, stop: threading.Event) -> None:
    """Run what other cells need, unless it is kept already.

    Raises:
        StoppedError: the run was interrupted; finished batches are kept.
        EitbenchError: it cannot be had.
    """
    run = CellRun(subject, progress, stop)
    if run.pending:
        run.run()
    store, cell = subject.store, subject.plan.cell
    for batch in store.batches(cell, "test"):
        for status, message in zip(batch.status, batch.message, strict=True):
            if status != "ok":
                store.forget(cell)
                raise EitbenchError(
                    f"What the cells of scenario {cell.scenario!r} are compared with cannot be "
                    f"computed: {message}."
                )


class CellRun:
    """Runs what is not kept yet of one cell.

    Attributes:
        pending: the batches that are not kept yet.
    """

    def __init__(self, subject: Subject, progress: CellProgress, stop: threading.Event) -> None:
        self.subject, self.progress, self.stop = subject, progress, stop
        self.plan, self.store = subject.plan, subject.store
        self.memory_mb = NAN
        self._worker: Worker | None = None
        self._restarts = 0
        self._losses = 0
        self._lost: Failure | None = None  # why the last worker was lost
        self._first_lost: Failure | None = None  # set where the first sample alone cost a worker
        self._alone = False  # whether samples are asked for one by one from the start
        self.pending = [
            (split, slice(start, min(start + self.plan.batch, size)))
            for split, size in subject.sizes.items()
            for start in range(0, size, self.plan.batch)
            if not self.store.has_batch(self.plan.cell, split, start)
        ]

    def run(self) -> dict[str, Any]:
        """Do the outstanding batches and return figures of the cell as a whole.

        Raises:
            StoppedError: the run was interrupted; finished batches are kept.
            EitbenchError: what is kept could not be written or read.
        """
        outstanding = sum(rows.stop - rows.start for _, rows in self.pending)
        self.progress.advance(sum(self.subject.sizes.values()) - outstanding)
        row: dict[str, Any] = {}
        failure = None
        try:
            ready = self._set_up()
            row |= {**ready.value, "setup_s": ready.seconds}
            row["first_frame_ms"] = self._first()
            row["batch_fps"] = self._batches()
            row |= self.subject.warm(lambda what, rows: self._answer("test", rows, what))
            row |= self._told()
        except WorkerLostError as lost:
            failure = lost.failure
        except (StoppedError, EitbenchError):
            raise
        except Exception as error:  # whatever else goes wrong here is this cell's affair
            failure = describe_exception(error)
        finally:
            self._close()
        if failure is not None:
            for split, rows in self.pending:
                lost_rows = Outcome(self.subject.blank).fail(rows.stop - rows.start, failure)
                self._keep(split, rows, lost_rows)
        return row | {"memory_mb": self.memory_mb}

    def _set_up(self) -> Reply:
        """Start a worker and make the subject ready in it.

        Raises:
            WorkerLostError: that fails.
        """
        log = self.store.log(self.plan.cell)
        self._worker = Worker(serve, self.subject.servant(), log=log, stop=self.stop)
        reply = self._ask("set_up", limit=self.plan.fit_limit_s, what="set-up")
        if reply.failure is not None:
            raise WorkerLostError(reply.failure)
        return reply

    def _set_up_again(self) -> None:
        """Go on with a new worker, a few times in a cell.

        Raises:
            WorkerLostError: not again.
        """
        reason = self._lost or Failure("error", "its process was lost")
        if self._restarts >= RESTARTS:
            self._losses += 1
            message = f"not tried after too many losses: {reason.message}"
            raise WorkerLostError(replace(reason, message=message))
        self._restarts += 1
        try:
            self._set_up()
        except WorkerLostError as lost:
            self._close()
            self._restarts, self._lost = RESTARTS, lost.failure  # another time would not help
            raise

    def _first(self) -> float:
        """Time of the first sample that a subject sees [ms]."""
        try:
            first = self._answer("test", slice(0, 1), "the first frame")
        except WorkerLostError as lost:
            self._first_lost = lost.failure
            return NAN
        return NAN if first.failure else first.seconds * 1e3

    def _told(self) -> dict[str, Any]:
        """What the subject was told, if it says so and is still there."""
        if self._worker is None or not self.subject.tells:
            return {}
        reply = self._ask("told", limit=TELL_LIMIT_S, what="its account of what it read")
        return {} if reply.failure is not None else self.subject.told(reply.value)

    def _batches(self) -> float:
        """Keep the answers to the pending batches, each leaving the list; samples per second."""
        done, seconds = 0, 0.0
        while self.pending:
            split, rows = self.pending[0]
            first = self._first_lost if (split, rows.start) == ("test", 0) else None
            outcome = Outcome(self.subject.blank)
            reply = None if self._alone or first else self._together(split, rows)
            failure = None if reply is None else reply.failure
            if reply is not None and failure is None:
                done, seconds = done + rows.stop - rows.start, seconds + reply.seconds
                outcome.add(*self.subject.values(split, rows, reply))
            elif failure is not None and BROKEN_CONTRACT.intersection(failure.kinds):
                outcome.fail(rows.stop - rows.start, failure)
            elif first is not None:
                self._one_by_one(split, slice(1, rows.stop), outcome.fail(1, first))
            else:
                before = self._losses
                self._one_by_one(split, rows, outcome)
                # Where no sample was to blame the batch was: the next would cost a worker as well.
                batch_lost = reply is None and not self._alone
                self._alone = self._alone or (batch_lost and self._losses == before)
            self._keep(split, rows, outcome)
            self.pending.pop(0)
        return done / seconds if seconds > 0 else NAN

    def _together(self, split: str, rows: slice) -> Reply | None:
        """The answer to a whole batch; None where it cost a worker."""
        try:
            return self._answer(split, rows, f"a batch of {rows.stop - rows.start} frames")
        except WorkerLostError:
            return None

    def _one_by_one(self, split: str, rows: slice, outcome: Outcome) -> None:
        """Ask sample by sample, so that only bad ones are lost."""
        for k in range(rows.start, rows.stop):
            row = slice(k, k + 1)
            try:
                reply = self._answer(split, row, "a frame")
            except WorkerLostError as lost:
                outcome.fail(1, lost.failure)
                continue
            if reply.failure is None:
                outcome.add(*self.subject.values(split, row, reply))
            else:
                outcome.fail(1, reply.failure)

    def _answer(self, split: str, rows: slice, what: str) -> Reply:
        """Ask the worker, or a new one if the last was lost.

        Raises:
            WorkerLostError: the worker is lost, or was and cannot be replaced.
        """
        if self._worker is None:
            self._set_up_again()
        limit = self.plan.frame_limit_s * (rows.stop - rows.start)
        try:
            return self._ask(*self.subject.request(split, rows), limit=limit, what=what)
        except WorkerLostError as lost:
            self._lost = lost.failure
            self._losses += 1
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

    def _keep(self, split: str, rows: slice, outcome: Outcome) -> None:
        self.store.save_batch(self.plan.cell, split, outcome.batch(rows.start))
        self.progress.advance(rows.stop - rows.start)


def judge_cell(subject: Judged, row: Mapping[str, Any] | None) -> None:
    """Score the kept samples of a cell and keep its rows.

    Args:
        row: figures of the cell as a whole; None for one that is not finished.
    """
    plan, test, store = subject.plan, subject.test, subject.store
    kept = Kept(store, plan.cell, "test", len(test), subject.blank)
    who = {"scenario": plan.cell.scenario, store.kind.name: plan.cell.name, **subject.labels}
    figures, whole = subject.figures(kept)
    described = test.samples.drop(columns=["sample", *figures.columns], errors="ignore")
    table = pd.DataFrame(
        {
            "suite": plan.suite,
            **who,
            "sample": test.samples["sample"].to_numpy(),
            "input_hash": subject.input_hashes,
            "status": kept.status,
            "message": kept.message,
        }
    )
    table = pd.concat([table, figures, described.reset_index(drop=True)], axis=1)
    table = table[kept.status != ""]
    ok = int((table["status"] == "ok").sum())
    cell_row = {
        **who,
        **subject.unknown,
        **(row or {}),
        **whole,
        "coverage": ok / len(table) if len(table) else 0.0,
        "n": len(table),
        "complete": row is not None and len(table) == len(test),
    }
    store.save_cell(plan.cell, table, cell_row)
