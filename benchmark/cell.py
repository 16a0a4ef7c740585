"""One cell of a run: one method on one scenario, in a worker, batch by batch."""

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.judge import fit_registration, judge
from eitbench.benchmark.progress import CellProgress
from eitbench.benchmark.store import Batch, Cell, RunStore
from eitbench.benchmark.timing import WARM_FRAMES, WARM_SECONDS, warm_percentiles
from eitbench.benchmark.worker import (
    Failure,
    Frames,
    Images,
    Reply,
    Task,
    Worker,
    WorkerLostError,
    scenario_splits,
    serve_method,
)
from eitbench.scenarios.datasets import Dataset
from eitbench.scenarios.scenario import Scenario

BATCH = 32
# Failures that asking again frame by frame would not mend.
BROKEN_CONTRACT = frozenset({"mutated", "shape", "dtype"})
NAN = float("nan")


@dataclass(frozen=True, eq=False)
class CellPlan:
    """What a cell is, apart from its data.

    Attributes:
        parameters: constructor parameters of the method; empty on track "default".
        batch: frames asked for at once; a run keeps to the number it was started with.
    """

    cell: Cell
    track: str
    parameters: dict[str, Any]
    suite: str
    scenario: Scenario
    plugins: tuple[Path, ...]
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

    def run(self) -> dict[str, Any]:
        """Do the outstanding batches and return the cell's timings."""
        plan, test = self.plan, self.data.test
        pending = [
            (split, start)
            for split in ("validation", "test")
            for start in range(0, len(self.data.voltages(split)), plan.batch)
            if not self.store.has_batch(plan.cell, split, start)
        ]
        outstanding = sum(len(self._frames(split, start)) for split, start in pending)
        self.progress.advance(self.data.n_frames - outstanding)
        row = dict.fromkeys(
            ("setup_s", "train_s", "first_frame_ms", "frame_ms_p50", "frame_ms_p99", "batch_fps"),
            NAN,
        )
        task = Task(
            test.sensor,
            test.reference,
            scenario_splits(plan.scenario),
            plan.cell.method,
            plan.parameters,
            plan.plugins,
        )
        parameters = ""
        log = self.store.log(plan.cell)
        with Worker(serve_method, task, log=log, stop=self.stop) as self.worker:
            try:
                reply = self._ask("fit", limit=plan.fit_limit_s, what="set-up")
                failure = reply.failure
                if failure is None:
                    parameters = reply.value
                    row["setup_s"] = reply.seconds
                    row |= self._single_frames()
                    row["batch_fps"] = self._batches(pending)
            except WorkerLostError as lost:
                failure = lost.failure
        if failure is not None:
            for split, start in pending:
                self._keep(split, start, _Outcome().fail(len(self._frames(split, start)), failure))
        return row | {"memory_mb": self.memory_mb, "parameters": parameters}

    def _single_frames(self) -> dict[str, float]:
        """Time the first frame, then warm single frames up to a number and a time."""
        frames = self.data.test.voltages
        first = self._reconstruct(frames[:1], "the first frame")
        warm: list[float] = []
        spent = 0.0
        while (
            first.failure is None and len(warm) < WARM_FRAMES and (spent < WARM_SECONDS or not warm)
        ):
            k = (len(warm) + 1) % len(frames)
            reply = self._reconstruct(frames[k : k + 1], "a single frame")
            if reply.failure is not None:
                break
            warm.append(reply.seconds * 1e3)
            spent += reply.seconds
        p50, p99 = warm_percentiles(warm)
        first_ms = NAN if first.failure else first.seconds * 1e3
        return {"first_frame_ms": first_ms, "frame_ms_p50": p50, "frame_ms_p99": p99}

    def _batches(self, pending: list[tuple[str, int]]) -> float:
        """Reconstruct and keep the `pending` batches, each leaving the list; frames per second."""
        done, seconds = 0, 0.0
        while pending:
            split, start = pending[0]
            frames = self._frames(split, start)
            outcome = _Outcome()
            try:
                reply = self._reconstruct(frames, f"a batch of {len(frames)} frames")
                if reply.failure is None:
                    done, seconds = done + len(frames), seconds + reply.seconds
                    outcome.images(self._masked(reply.value), self._mask, reply.seconds)
                elif BROKEN_CONTRACT.intersection(reply.failure.kinds):
                    outcome.fail(len(frames), reply.failure)
                else:
                    self._one_by_one(frames, outcome)
            except WorkerLostError as lost:
                if len(outcome):
                    self._keep(split, start, outcome.fail(len(frames) - len(outcome), lost.failure))
                    pending.pop(0)
                raise
            self._keep(split, start, outcome)
            pending.pop(0)
        return done / seconds if seconds > 0 else NAN

    def _one_by_one(self, frames: Frames, outcome: "_Outcome") -> None:
        """A batch that raised is asked for again frame by frame: only bad frames are lost."""
        for frame in frames:
            reply = self._reconstruct(frame[None], "a frame")
            if reply.failure is None:
                outcome.images(self._masked(reply.value), self._mask, reply.seconds)
            else:
                outcome.fail(1, reply.failure)

    def _reconstruct(self, frames: Frames, what: str) -> Reply:
        limit = self.plan.frame_limit_s * len(frames)
        return self._ask("reconstruct", frames, limit=limit, what=what)

    def _ask(self, *request: object, limit: float, what: str) -> Reply:
        reply: Reply = self.worker.ask(*request, limit=limit, what=what)
        self.memory_mb = reply.memory_mb
        return reply

    @property
    def _mask(self) -> NDArray[np.bool_]:
        return self.data.test.sensor.mask

    def _masked(self, images: Images) -> Images:
        """What a method says outside the sensor does not count: it is set to the background."""
        images[:, ~self._mask] = self.data.test.sensor.background
        return images

    def _frames(self, split: str, start: int) -> Frames:
        return self.data.voltages(split)[start : start + self.plan.batch]

    def _keep(self, split: str, start: int, outcome: "_Outcome") -> None:
        batch = outcome.batch(start, self.data.test.sensor.image_shape)
        self.store.save_batch(self.plan.cell, split, batch)
        self.progress.advance(len(batch.estimates))


class _Outcome:
    """Collects the frames of one batch in order, good and bad."""

    def __init__(self) -> None:
        self._images: list[Images | None] = []
        self._status: list[str] = []
        self._message: list[str] = []
        self._ms: list[float] = []

    def __len__(self) -> int:
        return len(self._status)

    def images(self, images: Images, mask: NDArray[np.bool_], seconds: float) -> None:
        """Add reconstructed frames that took `seconds` together."""
        for image in images:
            good = bool(np.isfinite(image[mask]).all())
            self._images.append(image if good else None)
            self._status.append("ok" if good else "invalid-output")
            self._message.append("" if good else "returned values that are not finite")
            self._ms.append(seconds * 1e3 / len(images))

    def fail(self, count: int, failure: Failure) -> "_Outcome":
        """Add `count` frames that were lost to `failure`."""
        self._images += [None] * count
        self._status += [failure.status] * count
        self._message += [failure.message] * count
        self._ms += [NAN] * count
        return self

    def batch(self, start: int, image_shape: tuple[int, int]) -> Batch:
        """All of it, with NaN where there is no image."""
        estimates = np.full((len(self), *image_shape), np.nan, dtype=np.float32)
        for estimate, image in zip(estimates, self._images, strict=True):
            if image is not None:
                estimate[:] = image
        return Batch(start, estimates, self._status, self._message, np.array(self._ms))


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
