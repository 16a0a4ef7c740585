"""One cell of a run: one method on one scenario, in a worker, batch by batch."""

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.judge import fit_registration, judge
from eitbench.benchmark.outcome import Outcome
from eitbench.benchmark.progress import CellProgress
from eitbench.benchmark.store import Cell, RunStore
from eitbench.benchmark.timing import WARM_FRAMES, WARM_SECONDS, warm_percentiles
from eitbench.benchmark.worker import (
    Failure,
    Frames,
    Images,
    Reply,
    StoppedError,
    Task,
    Worker,
    WorkerLostError,
    describe_exception,
    scenario_splits,
    serve_method,
)
from eitbench.scenarios.datasets import Dataset
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.scenario import Scenario

BATCH = 32
RESTARTS = 3
# Failures that asking again frame by frame would not mend.
BROKEN_CONTRACT = frozenset({"mutated", "shape", "dtype"})
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class CellPlan:
    """What a cell is, apart from its data.

    Attributes:
        parameters: constructor parameters of the method; empty on track "default".
        plugin: the file that registers the method, None for one that is installed.
        batch: frames asked for at once; a run keeps to the number it was started with.
    """

    cell: Cell
    track: str
    parameters: dict[str, Any]
    suite: str
    scenario: Scenario
    plugin: Path | None
    fit_limit_s: float
    frame_limit_s: float
    batch: int


@dataclass(frozen=True, eq=False)
class CellData:
    """The data of a cell's scenario.

    Attributes:
        validation: frames the registration is fitted on; None unless only positions are known.
    """

    test: Dataset
    validation: Dataset | None

    def voltages(self, split: str) -> Frames:
        """Frames (n, M) of "test" or "validation"."""
        dataset = self.test if split == "test" else self.validation
        return (
            np.empty((0, self.test.sensor.n_measurements)) if dataset is None else dataset.voltages
        )

    @property
    def n_frames(self) -> int:
        """Frames to reconstruct altogether."""
        return len(self.voltages("test")) + len(self.voltages("validation"))


def run_cell(
    plan: CellPlan, data: CellData, store: RunStore, progress: CellProgress, stop: threading.Event
) -> None:
    """Reconstruct what is not kept yet, then judge the cell; whatever the method does is a row.

    Raises:
        StoppedError: the run was interrupted; finished batches are kept.
        EitbenchError: what is kept could not be written or read.
    """
    row = _CellRun(plan, data, store, progress, stop).run()
    judge_cell(plan, data, store, row)


class _CellRun:
    def __init__(
        self,
        plan: CellPlan,
        data: CellData,
        store: RunStore,
        progress: CellProgress,
        stop: threading.Event,
    ) -> None:
        self.plan, self.data, self.store, self.progress, self.stop = (
            plan,
            data,
            store,
            progress,
            stop,
        )
        self.memory_mb = NAN
        self._task = Task(
            data.test.sensor,
            data.test.reference,
            scenario_splits(plan.scenario),
            plan.cell.method,
            plan.parameters,
            plan.plugin,
        )
        self._worker: Worker | None = None
        self._restarts = 0
        self._losses = 0
        self._lost: Failure | None = None  # why the last worker was lost
        self._first_lost: Failure | None = None  # set where the first frame alone cost a worker
        self._alone = False  # whether frames are asked for one by one from the start
        self._pending = [
            (split, start)
            for split in ("validation", "test")
            for start in range(0, len(data.voltages(split)), plan.batch)
            if not store.has_batch(plan.cell, split, start)
        ]

    def run(self) -> dict[str, Any]:
        """Do the outstanding batches and return the cell's timings."""
        outstanding = sum(len(self._frames(split, start)) for split, start in self._pending)
        self.progress.advance(self.data.n_frames - outstanding)
        row: dict[str, Any] = dict.fromkeys(
            ("setup_s", "train_s", "first_frame_ms", "frame_ms_p50", "frame_ms_p99", "batch_fps"),
            NAN,
        )
        row["parameters"] = ""
        failure = None
        try:
            fitted = self._fit()
            row |= {"parameters": fitted.value, "setup_s": fitted.seconds}
            row["first_frame_ms"] = self._first_frame()
            row["batch_fps"] = self._batches()
            row |= self._warm_frames()
        except WorkerLostError as lost:
            failure = lost.failure
        except (StoppedError, EitbenchError):
            raise
        except Exception as error:  # whatever else goes wrong here is this cell's affair
            failure = describe_exception(error)
        finally:
            self._close()
        if failure is not None:
            for split, start in self._pending:
                self._keep(split, start, Outcome().fail(len(self._frames(split, start)), failure))
        return row | {"memory_mb": self.memory_mb}

    def _fit(self) -> Reply:
        """Start a worker and fit the method in it.

        Raises:
            WorkerLostError: the method cannot be fitted.
        """
        plan = self.plan
        log = self.store.log(plan.cell)
        self._worker = Worker(serve_method, self._task, log=log, stop=self.stop)
        reply = self._ask("fit", limit=plan.fit_limit_s, what="set-up")
        if reply.failure is not None:
            raise WorkerLostError(reply.failure)
        return reply

    def _refit(self) -> None:
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
            self._fit()
        except WorkerLostError as lost:
            self._close()
            self._restarts, self._lost = RESTARTS, lost.failure  # fitting again would not help
            raise

    def _first_frame(self) -> float:
        """Time of the first frame that a fitted method sees [ms]."""
        try:
            first = self._reconstruct(self.data.test.voltages[:1], "the first frame")
        except WorkerLostError as lost:
            self._first_lost = lost.failure
            return NAN
        return NAN if first.failure else first.seconds * 1e3

    def _warm_frames(self) -> dict[str, float]:
        """Time single good frames, up to a number and a time; the first one comes last."""
        test = self.data.test.voltages
        kept = _Kept(self.store, self.plan.cell, "test", self.data.test)
        good = np.flatnonzero(kept.status == "ok")
        warm: list[float] = []
        spent = 0.0
        while len(good) and len(warm) < WARM_FRAMES and (spent < WARM_SECONDS or not warm):
            k = good[(len(warm) + 1) % len(good)]
            try:
                reply = self._reconstruct(test[k : k + 1], "a single frame")
            except WorkerLostError:  # every frame is kept by now
                break
            if reply.failure is not None:
                break
            warm.append(reply.seconds * 1e3)
            spent += reply.seconds
        p50, p99 = warm_percentiles(warm)
        return {"frame_ms_p50": p50, "frame_ms_p99": p99}

    def _batches(self) -> float:
        """Reconstruct and keep the pending batches, each leaving the list; frames per second."""
        done, seconds = 0, 0.0
        while self._pending:
            split, start = self._pending[0]
            frames = self._frames(split, start)
            outcome = Outcome()
            reply = None if self._alone else self._together(split, start, frames)
            failure = None if reply is None else reply.failure
            if reply is not None and failure is None:
                done, seconds = done + len(frames), seconds + reply.seconds
                outcome.images(self._masked(reply.value), self._mask, reply.seconds)
            elif failure is not None and BROKEN_CONTRACT.intersection(failure.kinds):
                outcome.fail(len(frames), failure)
            elif self._first_lost is not None and (split, start) == ("test", 0):
                self._one_by_one(frames[1:], outcome.fail(1, self._first_lost))
            else:
                before = self._losses
                self._one_by_one(frames, outcome)
                # Where no frame was to blame the batch was: the next would cost a worker as well.
                batch_lost = reply is None and not self._alone
                self._alone = self._alone or (batch_lost and self._losses == before)
            self._keep(split, start, outcome)
            self._pending.pop(0)
        return done / seconds if seconds > 0 else NAN

    def _together(self, split: str, start: int, frames: Frames) -> Reply | None:
        """The answer to a whole batch; None where it cost a worker, or is known to."""
        if self._first_lost is not None and (split, start) == ("test", 0):
            return None
        try:
            return self._reconstruct(frames, f"a batch of {len(frames)} frames")
        except WorkerLostError:
            return None

    def _one_by_one(self, frames: Frames, outcome: Outcome) -> None:
        """Ask frame by frame, so that only bad frames are lost."""
        for frame in frames:
            try:
                reply = self._reconstruct(frame[None], "a frame")
            except WorkerLostError as lost:
                outcome.fail(1, lost.failure)
                continue
            if reply.failure is None:
                outcome.images(self._masked(reply.value), self._mask, reply.seconds)
            else:
                outcome.fail(1, reply.failure)

    def _reconstruct(self, frames: Frames, what: str) -> Reply:
        """Ask the worker, or a new one if the last was lost.

        Raises:
            WorkerLostError: the worker is lost, or was and cannot be replaced.
        """
        if self._worker is None:
            self._refit()
        limit = self.plan.frame_limit_s * len(frames)
        try:
            return self._ask("reconstruct", frames, limit=limit, what=what)
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

    @property
    def _mask(self) -> NDArray[np.bool_]:
        return self.data.test.sensor.mask

    def _masked(self, images: Images) -> Images:
        """What a method says outside the sensor does not count: it is set to the background."""
        images[:, ~self._mask] = self.data.test.sensor.background
        return images

    def _frames(self, split: str, start: int) -> Frames:
        return self.data.voltages(split)[start : start + self.plan.batch]

    def _keep(self, split: str, start: int, outcome: Outcome) -> None:
        batch = outcome.batch(start, self.data.test.sensor.image_shape)
        self.store.save_batch(self.plan.cell, split, batch)
        self.progress.advance(len(batch.estimates))


def judge_cell(plan: CellPlan, data: CellData, store: RunStore, row: dict[str, Any]) -> None:
    """Score the kept frames of a cell and keep its rows; an unfinished cell has fewer of them."""
    test = data.test
    kept = _Kept(store, plan.cell, "test", test)
    table = pd.DataFrame(
        {
            "suite": plan.suite,
            "scenario": plan.cell.scenario,
            "method": plan.cell.method,
            "track": plan.track,
            "sample": test.samples["sample"].to_numpy(),
            "input_hash": test.frame_hashes,
            "status": kept.status,
            "message": kept.message,
        }
    )
    metrics = _metrics(data, store, plan.cell, kept).drop(columns="sample")
    described = test.samples.drop(columns=["sample", *metrics.columns], errors="ignore")
    table = pd.concat([table, metrics, described.reset_index(drop=True)], axis=1).assign(
        frame_ms=kept.frame_ms
    )
    table = table[kept.status != ""]
    ok = int((table["status"] == "ok").sum())
    methods_row = {
        "scenario": plan.cell.scenario,
        "method": plan.cell.method,
        "track": plan.track,
        **row,
        "coverage": ok / len(table) if len(table) else 0.0,
        "n": len(table),
        "complete": len(table) == len(test.voltages),
    }
    store.save_cell(plan.cell, table, methods_row)


class _Kept:
    """The kept frames of one split, in the order of the data set; status "" where none is kept.

    Attributes:
        estimates: (n, H, W), NaN where the status is not "ok".
    """

    def __init__(self, store: RunStore, cell: Cell, split: str, dataset: Dataset) -> None:
        n = len(dataset.voltages)
        self.estimates: Images = np.full((n, *dataset.sensor.image_shape), np.nan, dtype=np.float32)
        self.status = np.full(n, "", dtype=object)
        self.message = np.full(n, "", dtype=object)
        self.frame_ms = np.full(n, np.nan)
        for batch in store.batches(cell, split):
            rows = slice(batch.start, batch.stop)
            self.estimates[rows] = batch.estimates
            self.status[rows] = batch.status
            self.message[rows] = batch.message
            self.frame_ms[rows] = batch.frame_ms


def _metrics(data: CellData, store: RunStore, cell: Cell, kept: _Kept) -> pd.DataFrame:
    registration = None
    if data.validation is not None:
        validation = _Kept(store, cell, "validation", data.validation)
        registration = fit_registration(data.validation, validation.estimates)
    return judge(data.test, kept.estimates, registration)
