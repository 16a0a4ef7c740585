"""Methods in the cells of a run: asked for images, which are scored by the known truth."""

import json
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import joblib
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter

from eitbench.benchmark.metrics.evaluation import (
    LEAST_REGISTRATION_PRESSES,
    REGISTRATION_FRAMES,
    Scorer,
    fit_calibration,
    fit_registration,
    knows_loads,
)
from eitbench.benchmark.metrics.novelty import FRAME, KNOWN_FRAMES, frame_scores, residuals
from eitbench.benchmark.metrics.uncertainty import (
    STORED,
    kept_of_draws,
    normal_draws,
    sample_figures,
    summary,
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
from eitbench.benchmark.run.prior_knowledge import prior_knowledge_columns, read_report
from eitbench.benchmark.run.timing import Conditions
from eitbench.benchmark.rundir.cells import Values
from eitbench.benchmark.rundir.run_arrays import Truth
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.tuning.selection import recorded_selection
from eitbench.benchmark.workers.messages import (
    Cost,
    Reply,
    Seconds,
    WorkerLostError,
    array_in,
    parsed,
)
from eitbench.benchmark.workers.method_service import (
    BATCH,
    Frames,
    MethodService,
    learning_splits,
)
from eitbench.methods.method import DRAWS
from eitbench.methods.registry import METHOD_REGISTRY, place_methods
from eitbench.scenarios.arrays import Array, nearest_pixels
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings.fetch import cached_folder, fetch_recording
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario, opened
from eitbench.scenarios.suites.suite import Suite, has_training

WILD = 1000
"""An image beyond so many times the sensor's range is none: one such pixel would rule all means."""
WARM_SECONDS = 1.0
"""Time of warm single frames [s], and of those that are asked for in one message."""
TAIL_FRAMES, TAIL_SECONDS = 1000, 20.0
"""Frames that a 99th percentile needs, and how long they may take on a core of their own [s].
Longer than `WARM_SECONDS` is waited for them only where a scenario has as many, or a hundred small
scenarios of one sensor would mostly measure the same."""


Rows = slice | NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MethodData(CellData):
    """Frames of a scenario and their truth.

    Attributes:
        familiar: the scenario whose data methods learn and are tuned on, see `Suite.familiar`.
        reference: (M,) the first reference frame of `familiar`, which methods are fitted with.
        usual: frames as methods know them, by which the novelty of frames is judged; None where
            all frames of the suite are.
        validation: frames the registration, and the calibration of loads, are fitted on; None
            unless only positions or loads are known.
    """

    batch: ClassVar[int] = BATCH
    familiar: Scenario
    reference: Array
    usual: Dataset | None
    validation: Dataset | None

    @classmethod
    def load(
        cls, scenario: Scenario, suite: Suite, limit: int | None, *, jobs: int, progress: bool
    ) -> Self:
        """See `CellData.load`."""
        familiar = suite.familiar(scenario)
        for recording in suite.recordings(scenario):
            fetch_recording(recording, limit_s=suite.download_limit_s, progress=progress)
        test = load(scenario, split="test", limit=limit, jobs=jobs, progress=progress)
        first = test if familiar == scenario else load(familiar, split="test", limit=1)
        reference, usual = first.references[0], None
        if any(suite.familiar(s) == familiar for s in suite.scenarios if s != familiar):
            usual = load(familiar, split="validation", limit=KNOWN_FRAMES, jobs=jobs)
        if test.truth != "position" and not knows_loads(test.samples, test.truth):
            return cls(scenario, test, familiar, reference, usual, None)
        validation = load(familiar, split="validation", limit=REGISTRATION_FRAMES)
        least = LEAST_REGISTRATION_PRESSES
        if test.truth == "position" and len(validation) < least:
            # Every fifth press is for validation, the first one among them.
            raise InputError(
                f"Scenario {scenario.name!r} has {len(validation)} validation presses (every fifth "
                f"touch), and at least {least} are needed to find how images map to places: "
                f"record at least {5 * (least - 1) + 1} touches."
            )
        return cls(scenario, test, familiar, reference, usual, validation)

    @classmethod
    def known(cls) -> Mapping[str, type[Any]]:
        """See `CellData.known`."""
        return METHOD_REGISTRY.known()

    def unusable(self, name: str) -> str:
        """See `CellData.unusable`; also where there is no training split to learn from."""
        if why := super().unusable(name):
            return why
        known = self.known()
        if name in known and known[name].trains and not has_training(self.familiar):
            return f"{name!r} learns from a training split, and {self.familiar.name!r} has none."
        return ""

    def task(self, plan: CellPlan, store: RunStore) -> "MethodCellTask":
        """Return the method of the cell, with fewer test samples where the suite says so."""
        n = plan.suite.first.get(plan.cell.name, len(self.test))
        data = self if n >= len(self.test) else replace(self, test=self.test.first(n))
        return MethodCellTask(plan, store, data)

    @cached_property
    def scorer(self) -> Scorer:
        """It scores images of the test frames; all methods have the same."""
        return Scorer(self.test)

    def truth(self) -> Truth:
        """Return the true images, with the attributes that are needed to draw them."""
        test, sensor = self.test, self.test.sensor
        attributes = {
            "bounds": np.asarray(sensor.outline.bounds, dtype=np.float64),
            "background": sensor.background,
            "data_range": sensor.data_range,
        }
        arrays: dict[str, NDArray[Any]] = {
            "mask": sensor.mask,
            "sample": test.samples["sample"].to_numpy(np.int64),
        }
        if test.conductivity is not None:
            arrays["conductivity"] = test.conductivity
        elif test.classes is not None:
            arrays["classes"] = test.classes
        return attributes, arrays

    def selection(self, name: str, code: str) -> dict[str, Any] | None:
        """See `CellData.selection`."""
        return recorded_selection(self.familiar, name, code)

    def frames(self, split: str) -> tuple[Frames, Frames]:
        """Return the frames (n, M) of "validation", or else of "test", and their references."""
        dataset = self.validation if split == "validation" else self.test
        if dataset is None:
            none = np.empty((0, self.test.sensor.n_measurements))
            return none, none
        return dataset.voltages, dataset.references


@dataclass(frozen=True)
class MethodSetUp:
    """Answer of a method that is fitted; see `Method`."""

    parameters: dict[str, Any]
    train_s: Cost
    differs: str


_SET_UP = TypeAdapter(MethodSetUp)
_TIMES = TypeAdapter(Annotated[list[Seconds], Field(min_length=1)])
_SECONDS = TypeAdapter(dict[Literal["uncertainty", "novelty"], Cost])


def definition(plan: CellPlan) -> Callable[[], type[Any]] | None:
    """Return what gives a worker the class of a method that this process defined, if it did."""
    cls = place_methods().get(plan.cell.name)
    if cls is None or plan.plugin is not None or cls.__module__.startswith("eitbench."):
        return None
    given: Callable[[], type[Any]] = joblib.wrap_non_picklable_objects(
        lambda: cls, keep_wrapper=False
    )
    return given


@dataclass(frozen=True, eq=False)
class FrameTask(CellTask):
    """A method of any kind that answers frame by frame."""

    reports_prior_knowledge: ClassVar[bool] = True

    unknown: ClassVar[Mapping[str, Any]] = {
        "parameters": "",
        "registration": "",
        "load_calibration": "",
        "prior_knowledge": "",
        "overlap": NAN,
        "differs": "",
        **dict.fromkeys(("setup_s", "train_s", "first_frame_ms", "batch_fps"), NAN),
        **dict.fromkeys(("frame_ms_p50", "frame_ms_p95", "frame_ms_p99"), NAN),
    }

    @abstractmethod
    def request(self, split: str, rows: Rows) -> tuple[object, ...]:
        """Return the request for some samples of a split; "timing" is "test" once more, timed."""

    def set_up(self, value: object) -> dict[str, Any]:
        """Return its `parameters` as JSON, and what it says of its training and software."""
        answer: MethodSetUp = parsed(_SET_UP, value, "set-up")
        return {**vars(answer), "parameters": json.dumps(answer.parameters)}

    def warm(self, ask: Ask, beside: Conditions) -> dict[str, float]:
        """Return times of single valid frames; p99 is NaN below `TAIL_FRAMES` of them.

        p95 is of all frames that were timed; of few it is near the slowest.
        The first frame, which was timed before, is asked for last. Many go in one message, which
        takes longer than a fast method; the worker asks for them one by one.
        """
        if self.plan.cell.variant:
            return {}  # the parameters that are ranked are those that are timed
        # A last frame that is as slow as it may be, and what lies between frames.
        limit = self.plan.suite.frame_limit_s + 10 * WARM_SECONDS
        good, times = np.roll(np.flatnonzero(StoredSamples(self).valid), -1), np.empty(0)
        worth = beside.pinned and len(good) >= TAIL_FRAMES

        def enough(n: int, spent: float) -> bool:
            in_time = worth and spent * TAIL_FRAMES <= n * TAIL_SECONDS
            return n >= TAIL_FRAMES or (n > 0 and spent >= WARM_SECONDS and not in_time)

        while len(good) and not enough(len(times), times.sum()):
            most, next_ones = TAIL_FRAMES - len(times), np.roll(good, -len(times))
            request = "times", most, WARM_SECONDS, *self.request("timing", next_ones[:most])
            try:
                reply = ask(*request, limit=limit, what="single frames")
                if reply.failure is None:
                    found: list[float] = parsed(_TIMES, reply.value, "single frames")
            except WorkerLostError:  # every sample is stored by now
                break
            if reply.failure is not None:
                break
            if beside.counts():
                times = np.append(times, found)
            elif beside.over:
                break
        return {
            "frame_ms_p50": 1e3 * float(np.median(times)) if len(times) else NAN,
            "frame_ms_p95": 1e3 * float(np.percentile(times, 95)) if len(times) else NAN,
            "frame_ms_p99": 1e3 * float(np.percentile(times, 99))
            if len(times) >= TAIL_FRAMES
            else NAN,
        }


@dataclass(frozen=True, eq=False)
class MethodCellTask(FrameTask):
    """A method, asked for the images of frames."""

    data: MethodData

    @property
    def sizes(self) -> Mapping[str, int]:
        """The validation frames that a registration needs, then the test frames."""
        return {split: len(self.data.frames(split)[0]) for split in ("validation", "test")}

    @property
    def readable(self) -> tuple[Path, ...]:
        """See `CellTask`; also the recordings that it may learn from, where they lie."""
        scenarios = (self.data.scenario, self.data.familiar)
        sets = [of.recorded_set for of in scenarios if isinstance(of, RecordedScenario)]
        sets += [of.validation for of in sets if of.validation is not None]
        return (*super().readable, *(of.own or cached_folder(of) for of in sets))

    def service(self) -> MethodService:
        """Return the method with its problem."""
        plan, test = self.plan, self.data.test
        splits = partial(learning_splits, opened(self.data.familiar))
        return MethodService(
            test.sensor,
            self.data.reference,
            splits,
            plan.cell.name,
            plan.parameters,
            plan.plugin,
            definition(plan),
        )

    def request(self, split: str, rows: Rows) -> tuple[object, ...]:
        """Return a request for the images of frames, of "test" with all that is stated of them."""
        frames, references = self.data.frames(split)
        what = "reconstruct_and_state" if split == "test" else "reconstruct"
        return what, frames[rows], references[rows]

    def blank(self, n: int) -> dict[str, NDArray[Any]]:
        """Return images and times of NaN."""
        shape = (n, *self.data.test.sensor.image_shape)
        return {
            "conductivity": np.full(shape, np.nan, dtype=np.float32),
            **{name: np.full(n, np.nan) for name in ("frame_ms", "novelty", "novelty_ms")},
            **{name: np.full((n, *shape), np.nan) for name, shape in STORED.items()},
        }

    def values(self, split: str, rows: slice, reply: Reply) -> tuple[Values, NDArray[np.str_]]:
        """Return the images, the time of each frame, and figures of what is stated of them."""
        sensor = self.data.test.sensor
        shape = (rows.stop - rows.start, *sensor.image_shape)
        said = reply.value if isinstance(reply.value, dict) else {"images": reply.value}
        mask, images = sensor.mask, array_in(said.get("images"), np.float32, shape, "images")
        # Pixels outside the sensor do not count.
        images[:, ~mask] = sensor.background
        wrong = not_finite(np.isfinite(images[:, mask]).all(axis=1))
        most = WILD * sensor.data_range
        wild = np.abs(images[:, mask]).max(axis=1) > most
        wrong = np.where((wrong == "") & wild, f"returned values beyond {most:g} S/m", wrong)
        times = np.full(len(images), reply.seconds * 1e3 / len(images))
        found: dict[str, NDArray[Any]] = {"conductivity": images, "frame_ms": times}
        if "novelty" in said:
            found["novelty"] = array_in(said["novelty"], np.float32, shape[:1], "its novelty")
            known = np.isfinite(found["novelty"])
            wrong = np.where(wrong == "", not_finite(known, "a novelty that is"), wrong)
        if "uncertainty" in said:
            draws, placed = self._draws(images, said["uncertainty"])
            largest = np.maximum(draws.max(axis=(1, 2, 3)), -draws.min(axis=(1, 2, 3)))
            known = np.isfinite(largest)
            said_wrong = not_finite(known, "an uncertainty that is negative or")
            wrong = np.where(wrong == "", said_wrong, wrong)
            far = f"returned an uncertainty of values beyond {most:g} S/m"
            wrong = np.where((wrong == "") & (largest > most), far, wrong)
            good = wrong == ""
            draws[~good] = images[~good] = sensor.background
            found |= kept_of_draws(self._true_images(rows), draws, images, sensor, placed=placed)
        for name, seconds in parsed(_SECONDS, said.get("seconds", {}), "what it states").items():
            found[f"{name}_ms"] = np.full(len(images), seconds * 1e3 / len(images))
        for name in found.keys() & {*STORED, "novelty", "novelty_ms"}:
            found[name][wrong != ""] = np.nan
        images[wrong != ""] = np.nan
        return found, wrong

    def _draws(self, images: Frames, stated: object) -> tuple[NDArray[np.float32], bool]:
        """Draws (n, DRAWS, H, W) of a stated uncertainty, and True if the method drew them."""
        sensor = self.data.test.sensor
        draws = isinstance(stated, np.ndarray) and stated.ndim == images.ndim + 1
        shape = (len(images), DRAWS, *sensor.image_shape) if draws else images.shape
        array = array_in(stated, np.float32, shape, "its uncertainty")
        if not draws:
            array = normal_draws(images, np.where(array >= 0, array, np.nan))
        array[..., ~sensor.mask] = sensor.background
        return array, draws

    def prior_knowledge(self, value: object) -> dict[str, Any]:
        """Return the columns of `prior_knowledge_columns`."""
        data = self.data
        access, training = read_report(value)
        return prior_knowledge_columns(
            access, training, data.scenario, data.familiar, data.test, spent=self.plan.spent
        )

    def figures(self, stored: StoredSamples) -> tuple[pd.DataFrame, dict[str, Any]]:
        """Return the metrics of every image; registration and calibration as JSON, if any."""
        registration, calibration, validation = None, None, self.data.validation
        whole = {}
        if validation is not None:
            seen = StoredSamples(self, "validation").values["conductivity"]
            calibration = fit_calibration(validation, seen)
            if validation.truth == "position":
                registration = fit_registration(validation, seen)
                whole["registration"] = registration.to_json()
            if calibration is not None:
                whole["load_calibration"] = calibration.to_json()
        images = stored.values["conductivity"]
        table = self.data.scorer(images, registration, calibration)
        table = table.drop(columns="sample").assign(frame_ms=stored.values["frame_ms"])
        if np.isfinite(stored.values["novelty"]).any():
            table = table.assign(
                **{name: stored.values[name] for name in ("novelty", "novelty_ms")}
            )
        if self.data.usual is not None:
            table = table.assign(**residuals(self.data.test, images))
            table[FRAME] = frame_scores(self.data.test, self.data.usual)
        if np.isfinite(stored.values["uncertainty_ms"]).any():
            kept = {name: stored.values[name] for name in STORED}
            self._charge_failed(kept, stored.valid)
            places = kept["places"]
            if registration is not None:
                places = registration(places)
            table = table.assign(**sample_figures(kept, places, self._true_places()))
            whole["uncertainty"] = summary(kept)
        return table, whole

    def _charge_failed(self, kept: dict[str, NDArray[Any]], valid: NDArray[np.bool_]) -> None:
        """Charge frames without an answer what certainty of an untouched sensor gets."""
        sensor = self.data.test.sensor
        placed = bool((kept["placed"] == 1).any())
        for row in np.flatnonzero(~valid & np.isnan(kept["uncertainty_ms"])).tolist():
            truth = self._true_images(slice(row, row + 1))
            image = np.full((1, *sensor.image_shape), sensor.background, np.float32)
            draws = np.repeat(image[:, None], DRAWS, axis=1)
            for name, values in kept_of_draws(truth, draws, image, sensor, placed=placed).items():
                kept[name][row] = values[0]

    def _true_images(self, rows: slice) -> Array | None:
        """Conductivity (n, H, W) [S/m] on the pixels of estimates; None where it is not known."""
        known, shape = self.data.test.conductivity, self.data.test.sensor.image_shape
        return None if known is None else nearest_pixels(known[rows], shape)

    def _true_places(self) -> Array:
        """Places (n, 2) [m] of single presses, or in true images as they are found in estimates."""
        test = self.data.test
        truth = self._true_images(slice(None))
        if truth is not None:
            return locate(truth - test.sensor.background, test.sensor)
        if test.truth == "position" and "contacts" not in test.samples:
            return test.samples[["x_m", "y_m"]].to_numpy(np.float64)
        return np.full((len(test), 2), np.nan)
