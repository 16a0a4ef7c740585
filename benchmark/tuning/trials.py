"""Trials of a study: a method with some parameters, scored on more and more validation frames.

The method runs in a worker that is given the training split alone, within the limits of a run. A
method that hangs or dies costs its own trial only.
"""

import math
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from eitbench.benchmark.metrics import ktc
from eitbench.benchmark.metrics.evaluation import REGISTRATION_FRAMES, evaluate, fit_registration
from eitbench.benchmark.tuning.selection import FRAMES, Trial, validation_scenario
from eitbench.benchmark.workers.confinement import Confinement
from eitbench.benchmark.workers.messages import Failure, Reply, WorkerLostError, array_in, parsed
from eitbench.benchmark.workers.method_service import MethodService, learning_splits
from eitbench.benchmark.workers.restarting import RestartingWorker, SetUpFailedError
from eitbench.methods.registry import create, methods
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.descriptors import contact_places
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario
from eitbench.scenarios.suites.suite import Suite

if TYPE_CHECKING:  # the worker does without
    import optuna


PARTS = 3
"""A trial is scored on the first third of its frames, on two thirds, on all."""
SET_UP_LIMIT_S = 60.0
MOST_LISTED = 1000
SEARCHED = (bool, int, float, str, type(None))
"""What values of `search` are: they are kept as JSON, which has no tuples."""


class TrialService(MethodService):
    """The worker's side: one set of parameters after the other, for one problem."""

    def set_up(self) -> Reply:
        """Load the method; the reply holds its search space and defaults, None without one."""
        self.load_plugin()
        search = methods()[self.method].search
        if not search:
            return Reply(None, 0.0)
        values = _listed(self.method, search)
        made = create(self.method)
        for name, listed in values.items():
            if not hasattr(made, name):
                raise InputError(
                    f"Method {self.method!r} lists {name!r} in `search`, and has no such "
                    "parameter: correct its name."
                )
            for value in (*listed, getattr(made, name)):
                endless = isinstance(value, float) and not math.isfinite(value)
                if endless or not isinstance(value, SEARCHED):
                    raise InputError(
                        f"Method {self.method!r} lists {value!r} for {name!r} in `search`, or has "
                        "it by default: values are finite numbers, texts, truth values or None."
                    )
        defaults = {name: getattr(made, name) for name in values}
        return Reply({"values": values, "defaults": defaults}, 0.0)

    def fit(self, parameters: dict[str, Any]) -> Reply:
        """Fit the method with `parameters`."""
        return self.fitted(parameters)[1]


def _listed(method: str, search: object) -> dict[str, tuple[Any, ...]]:
    """The values that a method lists for each parameter, if it does so in the right form."""
    listed = dict[str, tuple[Any, ...]]()
    wrong = InputError(
        f"The `search` of method {method!r} has to be a dictionary of the names of parameters, "
        "each with a list of values."
    )
    if not isinstance(search, Mapping):
        raise wrong
    for name, values in search.items():
        single = isinstance(values, str | bytes) or not isinstance(values, Iterable)
        if single or not isinstance(name, str):
            raise wrong
        listed[name] = tuple(islice(values, MOST_LISTED + 1))
        if len(listed[name]) > MOST_LISTED:
            raise InputError(
                f"Method {method!r} lists more than {MOST_LISTED} values for {name!r} in `search`: "
                "list those that are worth a trial."
            )
    return listed


@dataclass(frozen=True)
class _DeclaredSearch:
    """What a worker says of a method: values of each parameter to choose from, and its default."""

    values: dict[str, tuple[Any, ...]]
    defaults: dict[str, Any]


_SEARCH = TypeAdapter(_DeclaredSearch | None)


class TrialFailedError(Exception):
    """The method gave no images; the message gives the reason, and below it where."""


class BudgetSpentError(Exception):
    """The time of the study ended in a trial, which says nothing of its parameters."""


class Clock:
    """Time in the method [s], `spent` so far of a limit."""

    def __init__(self, limit: float) -> None:
        self.limit, self.spent = limit, 0.0

    def ask(self, worker: RestartingWorker, *request: object, limit: float, what: str) -> Any:
        """Return the worker's answer, within `limit` and the rest of the time [s].

        Raises:
            TrialFailedError: there is none.
            BudgetSpentError: there was none within the rest of the time, which is below `limit`.
        """
        start = time.perf_counter()
        left = max(self.limit - self.spent, 0.0)
        try:
            reply = worker.ask(*request, limit=min(limit, left), what=what)
        except WorkerLostError as lost:
            if lost.failure.status == "timeout" and left < limit:
                raise BudgetSpentError from lost
            raise _failed(lost.failure) from lost
        finally:
            self.spent += time.perf_counter() - start
        if reply.failure is not None:
            raise _failed(reply.failure)
        return reply.value


def _failed(failure: Failure) -> TrialFailedError:
    return TrialFailedError("\n".join([failure.message, *failure.trace.splitlines()]))


LEAST_PRESSES = 8
"""Fewer presses choose nothing. Their images are registered with the presses that they are scored
by, and this has four unknowns: it maps two of three points exactly, whatever the images are."""


def choose_by_chance(data: Dataset) -> bool:
    """True of presses that are too few to choose parameters by."""
    return data.truth == "position" and len(data) < LEAST_PRESSES


class Validation:
    """The validation frames of one scenario and the worker that answers them.

    Attributes:
        data: the frames, with the noise of the test split.
        standard: (offset, scale): figures count as (figure - offset) / scale.
    """

    def __init__(
        self,
        scenario: Scenario,
        method: str,
        plugin: Path | None,
        suite: Suite,
        stop: threading.Event,
    ) -> None:
        # Presses also fit the registration, which takes more of them.
        limit = REGISTRATION_FRAMES if isinstance(scenario, RecordedScenario) else FRAMES
        self.scenario, self.suite = scenario, suite
        self.data = load(validation_scenario(scenario), split="validation", limit=limit)
        self.standard = (0.0, 1.0)
        splits = partial(_training_split, scenario)
        self._method = method
        self._folder = TemporaryDirectory(prefix="eitbench-", ignore_cleanup_errors=True)
        self._worker = RestartingWorker(
            TrialService(self.data.sensor, self.data.references[0], splits, method, {}, plugin),
            set_up_limit_s=SET_UP_LIMIT_S,
            stop=stop,
            memory_limit_mb=suite.memory_limit_mb,
            confinement=Confinement(Path(self._folder.name)),
        )
        self._images: NDArray[np.float32] = np.empty(0, np.float32)
        self._found: list[Array] = []

    def standardise(self) -> None:
        """Count figures as steps from that of an image of the untouched sensor.

        A step is the standard deviation of that image's figure between frames: so scenarios whose
        figures differ in unit and spread weigh alike, by a measure that no method decides. Where
        it is the same for every frame, as a correlation of 0 is, figures count as they are; errors
        of places, in units of the median distance of touches from their mean.
        """
        if self.data.truth == "position":
            places = contact_places(self.data.samples)
            away = np.linalg.norm(places - np.nanmean(places, axis=(0, 1)), axis=2)
            self.standard = (0.0, 1e3 * float(np.nanmedian(away)))
            return
        untouched = np.full(
            (len(self.data), *self.data.sensor.image_shape), self.data.sensor.background, np.float32
        )
        values = frame_figures(self.data, untouched)
        spread = float(np.std(values))
        self.standard = (float(np.mean(values)), spread) if spread > 0 else (0.0, 1.0)

    def close(self) -> None:
        """End the worker."""
        self._worker.close()
        self._folder.cleanup()

    def search(self) -> tuple[dict[str, tuple[Any, ...]], dict[str, Any]] | None:
        """Return the search space of the method and its defaults, from a new worker, if any.

        Raises:
            InputError: the method cannot be tuned.
        """
        try:
            said = self._worker.start().value
            found: _DeclaredSearch | None = parsed(_SEARCH, said, "set-up")
        except SetUpFailedError as failed:
            refused = InputError(failed.failure.message.removeprefix("InputError: "))
            refused.add_note(failed.failure.trace)
            raise refused from failed
        except WorkerLostError as lost:
            why = lost.failure.message
            raise InputError(f"Method {self._method!r} cannot be tuned: {why}.") from lost
        return None if found is None else (found.values, found.defaults)

    def fit(self, parameters: dict[str, Any], clock: Clock) -> None:
        """Fit the method.

        Raises:
            TrialFailedError: it cannot be fitted.
        """
        self._images = np.full((len(self.data), *self.data.sensor.image_shape), np.nan, np.float32)
        self._found = []
        self._ask(clock, "fit", parameters, limit=self.suite.fit_limit_s, what="set-up")

    def part(self, k: int, clock: Clock) -> Array:
        """Return standardised figures of the frames of part `k`; the parts come in order.

        Raises:
            TrialFailedError: there are no valid images.
        """
        n, sensor = len(self.data), self.data.sensor
        rows = slice(n * k // PARTS, n * (k + 1) // PARTS)
        count = rows.stop - rows.start
        if not count:
            return np.empty(0)
        limit, what = self.suite.frame_limit_s * count, f"{count} frames"
        frames = self.data.voltages[rows].copy(), self.data.references[rows].copy()
        value = self._ask(clock, "reconstruct", *frames, limit=limit, what=what)
        try:
            found = array_in(value, np.float32, (count, *sensor.image_shape), what)
        except WorkerLostError as lost:
            raise TrialFailedError(lost.failure.message) from lost
        if not np.isfinite(found[:, sensor.mask]).all():
            raise TrialFailedError("returned values that are not finite")
        self._images[rows] = found
        # Where images are registered, all that there are say how.
        seen = slice(0, rows.stop) if self.data.truth == "position" else rows
        self._found.append(frame_figures(_part_of(self.data, seen), self._images[seen])[-count:])
        offset, scale = self.standard
        return (self._found[-1] - offset) / scale

    def figure(self) -> float:
        """Return the figure of all frames, standardised, after all parts."""
        if self.data.truth == "position":
            value = float(np.median(frame_figures(self.data, self._images)))
        else:
            value = float(np.mean(np.concatenate(self._found)))
        offset, scale = self.standard
        return (value - offset) / scale

    def _ask(self, clock: Clock, *request: object, limit: float, what: str) -> Any:
        if not self._worker.running:
            self.search()  # a new worker's start is not the method's time
        return clock.ask(self._worker, *request, limit=limit, what=what)


def run_trial(
    trial: "optuna.trial.BaseTrial",
    parameters: dict[str, Any],
    validations: Sequence[Validation],
    seconds: float,
) -> Trial:
    """Score `parameters` on all `validations` by their mean figure; report every frame to `trial`.

    The method may take so many `seconds`.

    Raises:
        BudgetSpentError: it was about to take more.
    """
    clock = Clock(seconds)
    try:
        for validation in validations:
            validation.fit(parameters, clock)
        for k in range(PARTS):
            before = 0
            for validation in validations:
                n = len(validation.data)
                values = validation.part(k, clock)
                for step, value in enumerate(values, before + n * k // PARTS):
                    trial.report(float(value), step)
                before += n
            if k + 1 < PARTS and trial.should_prune():
                return Trial(parameters, None, "pruned", clock.spent)
        figure = float(np.mean([validation.figure() for validation in validations]))
        if not math.isfinite(figure):
            raise TrialFailedError("its figure is not finite")
    except TrialFailedError as failed:
        return Trial(parameters, None, "failed", clock.spent, str(failed))
    return Trial(parameters, figure, "ok", clock.spent)


def frame_figures(data: Dataset, estimates: NDArray[np.float32]) -> Array:
    """Return the figure (n,) of each frame that the scenario is ranked by, larger better.

    The score S of true conductivities, the challenge's score or the correlation of true classes,
    minus the localisation error [mm] of positions.
    """
    if data.truth == "position":
        rows = evaluate(data, estimates, fit_registration(data, estimates))
        return -rows["localisation_mm"].to_numpy(dtype=np.float64)
    return evaluate(data, estimates)[ranked_by(data)].to_numpy(dtype=np.float64)


def ranked_by(data: Dataset) -> str:
    """Return the metric that frames like those of `data` are ranked by."""
    if data.classes is not None and data.classes.shape[1:] == (ktc.SIDE, ktc.SIDE):
        return "ktc_score"
    return {"position": "localisation_mm", "classes": "cc"}.get(data.truth, "score")


def _part_of(data: Dataset, rows: slice) -> Dataset:
    return replace(
        data,
        voltages=data.voltages[rows],
        references=data.references[rows],
        samples=data.samples.iloc[rows].reset_index(drop=True),
        phantoms=data.phantoms[rows],
        classes=None if data.classes is None else data.classes[rows],
    )


def _training_split(scenario: Scenario, split: str, limit: int | None) -> Dataset:
    """Return the training split; a method is not given the frames that it is scored on here."""
    if split != "train":
        raise InputError(f"Methods are not given the {split} split while they are tuned.")
    return learning_splits(scenario, split, limit)
