"""One cell of a run: one method or operator on one scenario, run in a worker and scored.

It answers all samples, whatever it does. Answers are stored at once, with the state of the cell: a
run that is killed at any moment and resumed has the rows that it would have had.
"""

import json
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import TypeAdapter

from eitbench.benchmark.run.cell_task import NAN, CellTask, StoredSamples
from eitbench.benchmark.run.progress import Advance
from eitbench.benchmark.run.timing import Conditions
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.cells import Batch, Values
from eitbench.benchmark.rundir.kinds import CONDITIONS
from eitbench.benchmark.rundir.run_arrays import TRUTH
from eitbench.benchmark.workers.audit_hook import Watch
from eitbench.benchmark.workers.confinement import Confinement
from eitbench.benchmark.workers.messages import (
    BROKEN_CONTRACT,
    Failure,
    Reply,
    WorkerLostError,
)
from eitbench.benchmark.workers.restarting import RestartingWorker, WorkerHistory
from eitbench.benchmark.workers.worker import StoppedError, describe_exception
from eitbench.scenarios.errors import DataCorruptError, EitbenchError

PRIOR_KNOWLEDGE_LIMIT_S = 60.0
ACTIONS = 5  # of each kind that are shown
SAVE_SECONDS = 1.0  # samples that are asked for one by one are stored as often as this
# Conditions of a cell that was not timed, see `Conditions`.
_UNTIMED = {
    "timed": "",
    "actions": "",
    "trace": "",
    **dict.fromkeys(CONDITIONS, NAN),
}


def run_cell(
    task: CellTask,
    progress: Advance,
    stop: threading.Event,
    core: int | None,
    *,
    calm_ms: float | None,
    isolate: bool,
) -> None:
    """Run the batches that are not stored yet, then score the cell; whatever it does is a row.

    Args:
        core: the core that it has to itself; None where it shares the machine with other cells.
        calm_ms: see `Conditions`.
        isolate: true if it may neither use the network nor read files of others.

    Raises:
        StoppedError: the run was interrupted; finished batches are stored.
        EitbenchError: the store could not be written or read.
    """
    runner = BatchRunner(task, progress, stop, core, calm_ms=calm_ms, isolate=isolate)
    score_cell(task, runner.run())
    if task.plan.cell.variant:  # other tracks keep figures, no images
        task.store.forget_answers(task.plan.cell)


def prepare(task: CellTask, progress: Advance, stop: threading.Event) -> None:
    """Run a task that other cells need, unless its answers are stored already.

    Raises:
        StoppedError: the run was interrupted; finished batches are stored.
        EitbenchError: it failed.
    """
    runner = BatchRunner(task, progress, stop)
    if runner.pending:
        runner.run()
    cell, stored = task.plan.cell, StoredSamples(task)
    if not stored.valid.all():
        task.store.forget_answers(cell)
        raise EitbenchError(
            f"The exact gradients that operators on {cell.scenario!r} are compared with cannot be "
            f"computed: {stored.message[~stored.valid][0]}."
        )


def score_cell(task: CellTask, row: Mapping[str, Any] | None) -> None:
    """Score the stored samples of a cell and store its rows.

    Args:
        row: figures of the cell as a whole; None for one that is not finished.
    """
    plan, test, store = task.plan, task.data.test, task.store
    stored = StoredSamples(task)
    labels = {"scenario": plan.cell.scenario, store.kind.name: plan.cell.name}
    labels |= {name: getattr(plan, name) for name in store.kind.labels}
    figures, whole = task.figures(stored)
    described = test.samples.drop(columns=["sample", *figures.columns], errors="ignore")
    table = pd.DataFrame(
        {
            "suite": plan.suite.name,
            **labels,
            "sample": test.samples["sample"].to_numpy(),
            "input_hash": task.data.input_hashes,
            "status": stored.status,
            "message": stored.message,
        }
    )
    table = pd.concat([table, figures, described.reset_index(drop=True)], axis=1)
    table = table[stored.status != ""]
    cell_row = {
        **labels,
        "source": plan.source,
        **task.unknown,
        **_UNTIMED,
        **(row or {}),
        **whole,
        "coverage": stored.valid.sum() / len(table) if len(table) else 0.0,
        "machine": manifest.cpu_model(),
        "n": len(table),
        "complete": row is not None and len(table) == len(test),
    }
    store.save_cell(plan.cell, table, cell_row)


@dataclass
class CellState(WorkerHistory):
    """State of a cell, stored with each of its batches.

    Attributes:
        row: figures of the cell from its set-up and its first sample.
        failure: the reason why nothing more is asked for, if so.
        working: true if there is a worker.
        first_lost: the failure of the first sample, if it alone cost a worker.
        alone: true if samples are asked for one by one from the start.
        suspected: number of losses when a whole batch cost a worker and its samples are tried.
        done, seconds: samples answered in whole batches, and the time that took.
        actions: what its workers were noted to do, by kind.
        trace: where it raised an error first, as lines of a traceback; "" where it did not.
    """

    row: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None
    working: bool = False
    first_lost: Failure | None = None
    alone: bool = False
    suspected: int | None = None
    done: int = 0
    seconds: float = 0.0
    actions: dict[str, list[str]] = field(default_factory=dict)
    trace: str = ""


_STATE = TypeAdapter(CellState)


class BatchResult:
    """The samples of one batch of `n` in order, good and bad, as they are collected."""

    def __init__(self, task: CellTask, n: int) -> None:
        self._arrays = task.blank(n)
        self._status: list[str] = []
        self._message: list[str] = []

    def __len__(self) -> int:
        return len(self._status)

    def add(self, values: Values, status: Sequence[str], message: Sequence[str]) -> None:
        """Add samples; those without an answer have no values."""
        for name, array in values.items():
            self._arrays[name][len(self) : len(self) + len(status)] = array
        self._status += status
        self._message += message

    def answer(self, values: Values, wrong: NDArray[np.str_]) -> None:
        """Add answered samples with what is `wrong` with each, "" where nothing is."""
        self.add(values, ["invalid-output" if of else "ok" for of in wrong], wrong.tolist())

    def fail(self, count: int, failure: Failure) -> None:
        """Add `count` samples that were lost to `failure`."""
        self.add({}, [failure.status] * count, [failure.message] * count)

    def batch(self, start: int, state: str) -> Batch:
        """Return the batch that is stored, with the `state` of its cell."""
        values = {name: array[: len(self)] for name, array in self._arrays.items()}
        return Batch(start, self._status, self._message, values, state)


class BatchRunner:
    """Runs the pending batches of one cell.

    Attributes:
        pending: batches that are not stored yet, or not whole.
    """

    def __init__(
        self,
        task: CellTask,
        progress: Advance,
        stop: threading.Event,
        core: int | None = None,
        *,
        calm_ms: float | None = None,
        isolate: bool = False,
    ) -> None:
        self.task, self.progress, self._core, self._calm_ms = task, progress, core, calm_ms
        self.plan, self.store = task.plan, task.store
        batches = [
            (split, slice(start, min(start + self.plan.batch, size)))
            for split, size in task.sizes.items()
            for start in range(0, size, self.plan.batch)
        ]
        stored = [self.store.batch_length(self.plan.cell, s, rows.start) for s, rows in batches]
        self._stored = sum(stored)
        self.pending = [
            (split, rows)
            for (split, rows), count in zip(batches, stored, strict=True)
            if count < rows.stop - rows.start
        ]
        self._state = CellState()
        if self._stored:
            split, rows = batches[np.flatnonzero(stored)[-1]]
            text = self.store.batch(self.plan.cell, split, rows.start).state
            try:
                self._state = _STATE.validate_python(json.loads(text))
            except ValueError as error:
                raise DataCorruptError(
                    "A stored part of the run is damaged, so that it cannot go on: start a new run."
                ) from error
        self._service, self._stop = task.service(), stop
        self._logged: set[str] = set()
        self._readable = task.readable if isolate else None

    def run(self) -> dict[str, Any]:
        """Run the pending batches and return figures of the cell as a whole.

        Raises:
            StoppedError: the run was interrupted; finished batches are stored.
            EitbenchError: the store could not be written or read.
        """
        with TemporaryDirectory(prefix="eitbench-", ignore_cleanup_errors=True) as folder:
            self._watch = Watch(Path(folder))
            # What others are compared with is our own code.
            ours = self.plan.cell.name == TRUTH
            self._worker = RestartingWorker(
                self._service,
                set_up_limit_s=self.plan.suite.fit_limit_s,
                history=self._state,
                log=self.store.log(self.plan.cell),
                stop=self._stop,
                memory_limit_mb=self.plan.suite.memory_limit_mb,
                core=self._core,
                confinement=None
                if ours
                else Confinement(Path(folder), self._readable, self.task.recordings),
            )
            return self._run()

    def _run(self) -> dict[str, Any]:
        state = self._state
        self.progress(self._stored)
        measured: dict[str, Any] = {}
        try:
            if state.failure is not None:
                raise WorkerLostError(state.failure)
            if not self._stored:
                ready = self._worker.start()
                state.row = {**self.task.set_up(ready.value), "setup_s": ready.seconds}
                state.row["first_frame_ms"] = self._first_sample()
            elif state.working:
                self._worker.start()
            self._run_pending()
            beside = Conditions(self._core, self._calm_ms)
            measured = self.task.warm(self._send, beside) | beside.columns()
            measured |= self._prior_knowledge()
        except WorkerLostError as lost:
            state.failure = lost.failure
            self._note_trace(lost.failure)
        except (StoppedError, EitbenchError):
            raise
        except Exception as error:  # whatever else goes wrong here costs this cell only
            state.failure = describe_exception(error)
            self._note_trace(state.failure)
        finally:
            self._worker.close()
        if state.failure is not None:
            for split, rows in self.pending:
                result = self._stored_part(split, rows)
                stored = len(result)
                result.fail(rows.stop - rows.start - len(result), state.failure)
                self._save(split, rows, result)
                self.progress(rows.stop - rows.start - stored)
        self._note_actions()
        whole = {
            "batch_fps": state.done / state.seconds if state.seconds > 0 else NAN,
            "memory_mb": self._worker.memory_mb,
            "actions": json.dumps(state.actions) if state.actions else "",
            "trace": state.trace,
        }
        return state.row | measured | whole

    def _note_actions(self) -> None:
        """Add what the workers were noted to do to what those before an interruption did."""
        for kind, noted in self._watch.all_noted().items():
            known = self._state.actions.setdefault(kind, [])
            known += [what for what in noted if what not in known][: ACTIONS - len(known)]

    def _note_trace(self, failure: Failure) -> None:
        """Add where scored code raised an error to the log; the first is a figure of the cell."""
        if failure.trace and failure.trace not in self._logged:
            self._logged.add(failure.trace)
            with self.store.log(self.plan.cell).open("a", encoding="utf-8") as log:
                log.write(f"{failure.trace}\n{failure.message}\n")
        self._state.trace = self._state.trace or failure.trace

    def _first_sample(self) -> float:
        """Return the time of the first sample that the task sees [ms]; NaN where it fails."""
        try:
            first = self._ask("test", slice(0, 1), "the first frame")
        except WorkerLostError as lost:
            self._state.first_lost = lost.failure
            return NAN
        return NAN if first.failure else first.seconds * 1e3

    def _prior_knowledge(self) -> dict[str, Any]:
        """Return figures on the task's prior knowledge, if it reports them and still runs."""
        if not (self._worker.running and self.task.reports_prior_knowledge):
            return {}
        what = "the report of its prior knowledge"
        reply = self._worker.ask("prior_knowledge", limit=PRIOR_KNOWLEDGE_LIMIT_S, what=what)
        return {} if reply.failure is not None else self.task.prior_knowledge(reply.value)

    def _run_pending(self) -> None:
        """Store the answers to the pending batches; each leaves the list."""
        state = self._state
        while self.pending:
            split, rows = self.pending[0]
            result = self._stored_part(split, rows)
            stored = len(result)
            begun = bool(stored)
            if not begun and (split, rows.start) == ("test", 0) and state.first_lost is not None:
                result.fail(1, state.first_lost)
                begun = True
            if begun or state.alone or not self._ask_batch(split, rows, result):
                self._ask_samples(split, rows, result)
            self._save(split, rows, result)
            self.progress(rows.stop - rows.start - stored)
            self.pending.pop(0)

    def _ask_batch(self, split: str, rows: slice, result: BatchResult) -> bool:
        """Ask for a whole batch; False where its samples have to be asked for one by one."""
        state, n = self._state, rows.stop - rows.start
        try:
            reply = self._ask(split, rows, f"a batch of {n} frames")
        except WorkerLostError:
            state.suspected = state.losses
            return False
        if reply.failure is None:
            state.done, state.seconds = state.done + n, state.seconds + reply.seconds
            result.answer(*self.task.values(split, rows, reply))
            return True
        if BROKEN_CONTRACT.intersection(reply.failure.kinds):
            result.fail(n, reply.failure)
            return True
        return False

    def _ask_samples(self, split: str, rows: slice, result: BatchResult) -> None:
        """Ask sample by sample for the rest of a batch, so that only bad ones are lost."""
        state, saved = self._state, time.monotonic()
        for k in range(rows.start + len(result), rows.stop):
            if time.monotonic() - saved > SAVE_SECONDS:
                self._save(split, rows, result)
                saved = time.monotonic()
            row = slice(k, k + 1)
            try:
                reply = self._ask(split, row, "a frame")
            except WorkerLostError as lost:
                result.fail(1, lost.failure)
                continue
            if reply.failure is None:
                result.answer(*self.task.values(split, row, reply))
            else:
                result.fail(1, reply.failure)
        # Where no sample was to blame the batch was: the next would cost a worker as well.
        state.alone = state.alone or state.suspected == state.losses
        state.suspected = None

    def _ask(self, split: str, rows: slice, what: str) -> Reply:
        """Ask for some samples; raises `WorkerLostError` if that costs the worker."""
        limit = self.plan.suite.frame_limit_s * (rows.stop - rows.start)
        return self._send(*self.task.request(split, rows), limit=limit, what=what)

    def _send(self, *request: object, limit: float, what: str) -> Reply:
        reply = self._worker.ask(*request, limit=limit, what=what)
        if reply.failure is not None:
            self._note_trace(reply.failure)
        return reply

    def _stored_part(self, split: str, rows: slice) -> BatchResult:
        """Return the samples of a batch that are stored already."""
        cell, result = self.plan.cell, BatchResult(self.task, rows.stop - rows.start)
        if self.store.batch_length(cell, split, rows.start):
            batch = self.store.batch(cell, split, rows.start)
            result.add(batch.values, batch.status, batch.message)
        return result

    def _save(self, split: str, rows: slice, result: BatchResult) -> None:
        self._state.working = self._worker.running
        self._note_actions()
        batch = result.batch(rows.start, json.dumps(asdict(self._state)))
        self.store.save_batch(self.plan.cell, split, batch)
