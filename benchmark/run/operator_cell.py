"""Forward operators in the cells of a run: voltages and gradients, compared with the model's."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import TypeAdapter

from eitbench.benchmark.metrics.operator_metrics import (
    Standard,
    correlation,
    cosine,
    mse,
    relative_error,
)
from eitbench.benchmark.run.cell_task import (
    NAN,
    Ask,
    CellData,
    CellPlan,
    CellTask,
    StoredSamples,
    not_finite,
)
from eitbench.benchmark.run.timing import Conditions
from eitbench.benchmark.rundir.cells import Cell, Values
from eitbench.benchmark.rundir.run_arrays import TOUCHES_KEPT, TRUTH, Truth
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.workers.messages import (
    Cost,
    Reply,
    Seconds,
    WorkerLostError,
    array_in,
    parsed,
)
from eitbench.benchmark.workers.operator_service import OperatorService, ReferenceModelService
from eitbench.methods.registry import OPERATOR_REGISTRY
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import SNR_COLUMNS, load
from eitbench.scenarios.data.simulation import clean_frames
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.suites.scenario import Scenario, SimulatedScenario
from eitbench.scenarios.suites.suite import Suite

# A median of fewer says little; more of a slow operator is not worth the wait.
WARM_BATCHES, WARM_SECONDS, ENOUGH_BATCHES = 3, 2.0, 20
MODEL_LIMIT_S = 600.0


@dataclass(frozen=True, eq=False)
class OperatorData(CellData):
    """True images, and their noise-free voltages by the model that the data come from.

    Attributes:
        clean: (n, M) voltages [V/A].
        reference: (M,) voltages of the untouched sensor [V/A].
        standard: of the clean voltages of the whole validation split.
    """

    batch: ClassVar[int] = 64

    clean: Array
    reference: Array
    standard: Standard

    @classmethod
    def load(
        cls, scenario: Scenario, suite: Suite, limit: int | None, *, jobs: int, progress: bool
    ) -> Self:
        """See `CellData.load`."""
        if not isinstance(scenario, SimulatedScenario):
            raise InputError(
                f"Scenario {scenario.name!r} is recorded: operators need a known conductivity."
            )
        if scenario.imperfections.drawn or scenario.imperfections.mesh == "slab":
            raise InputError(
                f"The sensor of scenario {scenario.name!r} varies, or has three dimensions: "
                "operators are compared on one sensor of two dimensions."
            )
        cls.known()  # loads their libraries here, so that workers are forked with them
        measured = load(scenario, split="test", limit=limit, jobs=jobs, progress=progress)
        # Noise is no matter of operators.
        test = replace(measured, samples=measured.samples.drop(columns=list(SNR_COLUMNS)))
        known = clean_frames(
            scenario, "validation", scenario.validation, jobs=jobs, progress=progress
        )
        clean = clean_frames(scenario, "test", len(test))
        return cls(scenario, test, clean.voltages, clean.untouched[0], Standard.of(known.voltages))

    @classmethod
    def known(cls) -> Mapping[str, type[Any]]:
        """See `CellData.known`."""
        return OPERATOR_REGISTRY.known()

    def unusable(self, name: str) -> str:
        """Return "": an operator that cannot run fails."""
        return ""

    def task(self, plan: CellPlan, store: RunStore) -> CellTask:
        """Return the operator of the cell, or the model."""
        kind = ReferenceModelTask if plan.cell.name == TRUTH else OperatorCellTask
        return kind(plan, store, self)

    def preparation(self, plan: CellPlan) -> CellPlan | None:
        """Return the model, whose gradients those of all operators are compared with."""
        if plan.cell.name == TRUTH:
            return None
        # The suite's limits are for what is ranked.
        limits = dict.fromkeys(("fit_limit_s", "frame_limit_s"), MODEL_LIMIT_S)
        suite = plan.suite.model_copy(update=limits)
        return replace(plan, cell=Cell(plan.cell.scenario, TRUTH), suite=suite, plugin=None)

    def truth(self) -> Truth:
        """Return the true voltages, with their mean and standard deviation, and a few touches."""
        sensor = self.test.sensor
        attributes = {"bounds": np.asarray(sensor.outline.bounds, dtype=np.float64)}
        arrays = {
            "sample": self.test.samples["sample"].to_numpy(np.int64),
            "voltages": self.clean,
            "reference": self.reference,
            "mean": self.standard.mean,
            "std": self.standard.std,
            "conductivity": self.images(slice(0, TOUCHES_KEPT)).astype(np.float32),
        }
        return attributes, arrays

    def images(self, rows: slice) -> Array:
        """Return true conductivity (k, H, W) [S/m], drawn anew, since all images would be large."""
        return np.array([rasterise(p, self.test.sensor) for p in self.test.phantoms[rows]])

    def cotangents(self, rows: slice) -> Array:
        """Return the cotangents (k, M) of gradients: the response to the touch [V/A]."""
        return np.asarray(self.clean[rows] - self.reference)

    @cached_property
    def input_hashes(self) -> list[str]:
        """SHA-256 (hex) of every image together with its cotangent."""
        return [
            sha256(self.images(row).tobytes() + self.cotangents(row).tobytes()).hexdigest()
            for row in (slice(k, k + 1) for k in range(len(self.clean)))
        ]


@dataclass(frozen=True, eq=False)
class ReferenceModelTask(CellTask):
    """The model that the data come from, asked for the gradients of one scenario."""

    data: OperatorData

    def service(self) -> ReferenceModelService:
        """Return the model."""
        assert isinstance(self.data.scenario, SimulatedScenario)
        return ReferenceModelService(self.data.scenario)

    def request(self, split: str, rows: slice) -> tuple[object, ...]:
        """Return a request for the gradients of some samples."""
        return "gradients", rows, self.data.cotangents(rows)

    def blank(self, n: int) -> dict[str, NDArray[Any]]:
        """Return gradients of NaN."""
        shape = (n, *self.data.test.sensor.image_shape)
        return {"gradient": np.full(shape, np.nan, dtype=np.float32)}

    def values(self, split: str, rows: slice, reply: Reply) -> tuple[Values, NDArray[np.str_]]:
        """Return the gradients."""
        return {"gradient": reply.value}, not_finite(np.isfinite(reply.value).all(axis=(1, 2)))


@dataclass(frozen=True)
class OperatorSetUp:
    """Answer of an operator that is made; see `Operator`."""

    train_s: Cost
    trained_on: str


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Answer of an operator for n images, see `OperatorService.evaluate`."""

    voltages: object
    gradients: object
    forward_s: Seconds
    grad_s: Seconds


_SET_UP = TypeAdapter(OperatorSetUp)
_EVALUATION = TypeAdapter(Evaluation)
_EVALUATING = "an evaluation"


def evaluation(reply: Reply) -> Evaluation:
    """Return the answer of an operator, its arrays as they came."""
    found: Evaluation = parsed(_EVALUATION, reply.value, _EVALUATING)
    return found


@dataclass(frozen=True, eq=False)
class OperatorCellTask(CellTask):
    """An operator, asked for the voltages and gradients of true images."""

    data: OperatorData

    unknown: ClassVar[Mapping[str, Any]] = {
        "trained_on": "",
        **dict.fromkeys(
            ("setup_s", "train_s", "first_frame_ms", "forward_ms", "grad_ms", "batch_fps"), NAN
        ),
    }

    def service(self) -> OperatorService:
        """Return the operator for the nominal sensor."""
        plan = self.plan
        return OperatorService(self.data.test.sensor, plan.cell.name, plan.plugin)

    def set_up(self, value: object) -> dict[str, Any]:
        """Return what it says of its training."""
        answer: OperatorSetUp = parsed(_SET_UP, value, "set-up")
        return vars(answer)

    def request(self, split: str, rows: slice) -> tuple[object, ...]:
        """Return a request for the voltages and gradients of images."""
        return "evaluate", self.data.images(rows), self.data.cotangents(rows)

    def blank(self, n: int) -> dict[str, NDArray[Any]]:
        """Return voltages, cosines and times of NaN."""
        return {
            "voltages": np.full((n, self.data.test.sensor.n_measurements), np.nan),
            "grad_undefined": np.zeros(n, dtype=bool),
            **{name: np.full(n, np.nan) for name in ("grad_cosine", "forward_ms", "grad_ms")},
        }

    def values(self, split: str, rows: slice, reply: Reply) -> tuple[Values, NDArray[np.str_]]:
        """Return voltages, cosines of gradients with the model's, and the time of each sample."""
        found, n, sensor = evaluation(reply), rows.stop - rows.start, self.data.test.sensor
        shapes = (n, sensor.n_measurements), (n, *sensor.image_shape)
        voltages = array_in(found.voltages, np.float64, shapes[0], _EVALUATING)
        inside = sensor.mask
        gradients = array_in(found.gradients, np.float64, shapes[1], _EVALUATING)[:, inside]
        good = np.asarray(np.isfinite(np.hstack([voltages, gradients])).all(axis=1))
        cosines, undefined = cosine(
            np.where(good[:, None], gradients, 0.0), self._model_gradients(rows)[:, inside]
        )
        values = {
            "voltages": np.where(good[:, None], voltages, np.nan),
            "grad_cosine": np.where(good, cosines, np.nan),
            "grad_undefined": undefined & good,
            "forward_ms": np.full(n, found.forward_s * 1e3 / n),
            "grad_ms": np.full(n, found.grad_s * 1e3 / n),
        }
        return values, not_finite(good)

    def _model_gradients(self, rows: slice) -> Array:
        """Return the model's gradients (k, H, W) of `rows`, which all lie in one batch."""
        start = rows.start - rows.start % self.plan.batch
        stored = self.store.batch(Cell(self.plan.cell.scenario, TRUTH), "test", start)
        inside = slice(rows.start - start, rows.stop - start)
        return stored.values["gradient"][inside].astype(np.float64)

    def warm(self, ask: Ask, beside: Conditions) -> dict[str, float]:
        """Return the time of a sample in whole valid batches: the median over batches [ms]."""
        valid = StoredSamples(self).valid
        size = min(self.plan.batch, len(self.data.clean))
        batches = [
            slice(start, start + size)
            for start in range(0, len(self.data.clean) - size + 1, size)
            if valid[start : start + size].all()
        ]
        limit, found, spent = self.plan.suite.frame_limit_s * size, list[Evaluation](), 0.0
        while batches and not (
            len(found) >= WARM_BATCHES and (spent >= WARM_SECONDS or len(found) >= ENOUGH_BATCHES)
        ):
            request = self.request("test", batches[len(found) % len(batches)])
            try:
                reply = ask(*request, limit=limit, what="a warm batch")
            except WorkerLostError:  # every sample is stored by now
                break
            if reply.failure is not None:
                break
            if beside.counts():
                found.append(evaluation(reply))
                spent += reply.seconds
            elif beside.over:
                break
        if not found:
            return {}
        return {
            "forward_ms": float(np.median([f.forward_s for f in found])) * 1e3 / size,
            "grad_ms": float(np.median([f.grad_s for f in found])) * 1e3 / size,
        }

    def figures(self, stored: StoredSamples) -> tuple[pd.DataFrame, dict[str, float]]:
        """Return the errors of the voltages, and what is stored of the gradients."""
        data, valid = self.data, stored.valid
        truth, estimate = data.clean[valid], stored.values["voltages"][valid]
        table = pd.DataFrame({"mse": NAN, "rel_error": NAN}, index=np.arange(len(valid)))
        table.loc[valid, "mse"] = mse(truth, estimate, data.standard)
        table.loc[valid, "rel_error"] = relative_error(truth, estimate)
        for name in ("grad_cosine", "grad_undefined", "forward_ms", "grad_ms"):
            table[name] = stored.values[name]
        clusters = data.test.samples["cluster"].to_numpy()[valid]
        r = correlation(truth, estimate, data.reference, clusters)
        return table, {"r": r.value, "r_low": r.low, "r_high": r.high}
