"""Hyper-parameters chosen on the validation split, with the same budget for every method.

The rule, recorded with every choice: coordinate search over the values that a method declares in
`search`, from its defaults, at most 16 trials, each judged on the first 18 validation samples (100
of a recorded set) with the noise of the test split, by the figure the scenario is ranked by. The
test split is never loaded here.
"""

import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from eitbench.benchmark.judge import REGISTRATION_FRAMES, fit_registration, judge
from eitbench.benchmark.method_worker import learning_splits
from eitbench.methods import Problem, create, load_plugin, methods
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.datasets import Dataset, load
from eitbench.scenarios.errors import DataUnavailableError, InputError
from eitbench.scenarios.scenario import RecordedScenario, Scenario, SimulatedScenario
from eitbench.scenarios.sensors import content_hash

_log = logging.getLogger(__name__)

BUDGET = 16
FRAMES = 18
# What a scenario is ranked by, for each kind of truth; larger is better here.
FIGURES = {
    "conductivity": "mean score S",
    "position": "minus the median localisation error [mm]",
    "classes": "mean correlation",
}
PACKAGED = Path(__file__).parent / "selected"


@dataclass(frozen=True)
class Trial:
    """One set of parameters and its figure; None where the method failed."""

    parameters: dict[str, Any]
    figure: float | None


@dataclass(frozen=True)
class Choice:
    """What was chosen for one method, and every trial that led to it."""

    parameters: dict[str, Any]
    figure: float | None
    trials: tuple[Trial, ...]


def coordinate_search(
    search: Mapping[str, Sequence[Any]],
    start: Mapping[str, Any],
    evaluate: Callable[[dict[str, Any]], float | None],
    budget: int = BUDGET,
) -> Choice:
    """Sweep one parameter after the other, keeping the best value, until nothing improves."""
    trials = {_key(start): Trial(dict(start), evaluate(dict(start)))}
    best = trials[_key(start)]
    improved = True
    while improved:
        improved = False
        for name, values in search.items():
            for value in values:
                parameters = {**best.parameters, name: value}
                if _key(parameters) in trials:
                    continue
                if len(trials) >= budget:
                    return Choice(best.parameters, best.figure, tuple(trials.values()))
                trial = Trial(parameters, evaluate(parameters))
                trials[_key(parameters)] = trial
                if _figure(trial) > _figure(best):
                    best, improved = trial, True
    return Choice(best.parameters, best.figure, tuple(trials.values()))


def _key(parameters: Mapping[str, Any]) -> str:
    return json.dumps(parameters, sort_keys=True)


def _figure(trial: Trial) -> float:
    return -np.inf if trial.figure is None else trial.figure


def validation_scenario(scenario: Scenario) -> Scenario:
    """The scenario whose validation split has the noise of the test split.

    A rung of the ladder from simulation to reality is tuned on what its user can simulate: the
    nominal sensor with the noise that is declared for the validation split.
    """
    if isinstance(scenario, SimulatedScenario) and scenario.imperfections is None:
        noise = scenario.noise.model_copy(update={"validation": scenario.noise.test})
        return scenario.model_copy(update={"noise": noise})
    return scenario


def choose(scenario: Scenario, method: str) -> Choice | None:
    """The choice for `method` on `scenario`; None where it declares nothing to choose."""
    search = methods()[method].search
    if not search:
        return None
    seen = validation_scenario(scenario)
    # Presses also fit the registration, which takes more of them.
    limit = REGISTRATION_FRAMES if isinstance(scenario, RecordedScenario) else FRAMES
    data = load(seen, split="validation", limit=limit)
    if data.truth not in FIGURES or not len(data.voltages):
        return None
    problem = Problem(data.sensor, data.reference, partial(_training_split, scenario))
    made = create(method)
    missing = [name for name in search if not hasattr(made, name)]
    if missing:
        raise InputError(
            f"Method {method!r} lets {missing[0]!r} be chosen, but has no such parameter."
        )
    start = {name: getattr(made, name) for name in search}

    def evaluate(parameters: dict[str, Any]) -> float | None:
        try:
            candidate = create(method, **parameters)
            candidate.fit(problem)
            return ranked_figure(data, candidate.reconstruct(data.voltages.copy()))
        except (Exception, SystemExit):
            return None  # a failed trial is recorded as such and cannot win

    return coordinate_search(search, start, evaluate)


def ranked_figure(data: Dataset, estimates: np.ndarray[Any, Any]) -> float | None:
    """The figure a scenario is ranked by, larger better; None where an image is not finite."""
    estimates = np.asarray(estimates, dtype=np.float32)
    if not np.isfinite(estimates[:, data.sensor.mask]).all():
        return None  # what fails here would fail in a run
    if data.truth == "position":
        rows = judge(data, estimates, fit_registration(data, estimates))
        value = -float(np.median(rows["localisation_mm"].to_numpy()))
    else:
        rows = judge(data, estimates)
        value = float(rows["cc" if data.truth == "classes" else "score"].to_numpy().mean())
    return value if np.isfinite(value) else None


def _training_split(scenario: Scenario, split: str, limit: int | None) -> Dataset:
    """What methods learn from; the frames they are judged on here are not given to them."""
    if split != "train":
        raise InputError(f"Methods are not given the {split} split while they are tuned.")
    return learning_splits(scenario, split, limit)


def tune(
    scenarios: Sequence[Scenario],
    names: Sequence[str],
    folder: Path,
    *,
    plugins: Sequence[Path] = (),
    jobs: int = 1,
) -> Iterator[tuple[str, str, Choice]]:
    """Choose for every scenario and method, `jobs` at a time; yield each choice once recorded.

    Scenarios with the same validation data are tuned once. A recorded set whose data cannot be had
    is left out, with a warning.

    Raises:
        DataUnavailableError: no scenario is left.
    """
    different = {validation_key(s): s for s in reversed(scenarios) if _at_hand(s)}
    if not different:
        raise DataUnavailableError("There is nothing to tune on: fetch the recorded sets first.")
    cells = [(s, name) for s in reversed(different.values()) for name in names]
    parallel = joblib.Parallel(n_jobs=jobs, return_as="generator", inner_max_num_threads=1)
    found = parallel(joblib.delayed(_choose)(s, name, plugins) for s, name in cells)
    for (scenario, name), choice in zip(cells, found, strict=True):
        if choice is not None:
            record(scenario, {name: choice}, folder)
            yield scenario.name, name, choice


def _at_hand(scenario: Scenario) -> bool:
    try:
        load(scenario, split="validation", limit=1)
    except DataUnavailableError as error:
        _log.warning("Scenario %r is left out: %s", scenario.name, error)
        return False
    return True


def _choose(scenario: Scenario, method: str, plugins: Sequence[Path]) -> Choice | None:
    for plugin in plugins:
        load_plugin(plugin)
    return choose(scenario, method)


def validation_key(scenario: Scenario) -> str:
    """SHA-256 (hex) of what decides a choice: sensor, validation phantoms, noise; or the set.

    Scenarios that differ in name, in sample numbers or in their test phantoms share their choices,
    and so do a nominal and a calibrated one: what is compared is the calibration alone.
    """
    seen = validation_scenario(scenario)
    if isinstance(seen, SimulatedScenario):
        return content_hash(
            {
                "sensor": seen.nominal_sensor.describe(),
                "clean": seen.clean_parameters("validation"),
                "noise": seen.noise.validation,
            }
        )
    named = {"name": seen.recorded_set.name, "calibrated": False}
    return seen.model_copy(update=named).data_hash("validation")


def record(scenario: Scenario, choices: Mapping[str, Choice], folder: Path) -> Path:
    """Add `choices` to the file for the data of `scenario` in `folder`."""
    key = validation_key(scenario)
    path = folder / f"{key[:16]}.json"
    known = _choices(path)
    content = {
        "made_on": scenario.name,
        "validation_key": key,
        "rule": " ".join((__doc__ or "").split("\n\n", 1)[1].split()),
        "choices": dict(sorted((known | {m: asdict(c) for m, c in choices.items()}).items())),
    }
    folder.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    partial.write_text(json.dumps(content, indent=1) + "\n")
    partial.replace(path)
    return path


def selected_parameters(scenario: Scenario, method: str) -> dict[str, Any] | None:
    """The recorded choice for `method` on data like `scenario`'s; None where there is none.

    The user's own choices (in the cache) come before the packaged ones.
    """
    key = validation_key(scenario)
    for folder in (user_choices(), PACKAGED):
        path = folder / f"{key[:16]}.json"
        choice = _choices(path).get(method)
        if choice is not None:
            parameters: dict[str, Any] = choice["parameters"]
            return parameters
    return None


def _choices(path: Path) -> dict[str, Any]:
    """The choices that a file holds; a damaged file is named and counts as empty."""
    if not path.is_file():
        return {}
    try:
        choices: dict[str, Any] = json.loads(path.read_text())["choices"]
        for choice in choices.values():
            dict(choice["parameters"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        _log.warning("%s is damaged and is not used: delete it and tune again.", path)
        return {}
    return choices


def user_choices() -> Path:
    """Where the user's own choices are kept."""
    return cache_dir() / "selected"
