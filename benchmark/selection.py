"""Hyper-parameters chosen on the validation split, with the same budget for every method.

The rule, recorded with every choice: coordinate search over the values that a method declares in
`search`, from its defaults, at most BUDGET trials, each judged on the first FRAMES validation
samples with the noise of the test split, by the figure the scenario is ranked by. The test split is
never loaded here.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.benchmark.judge import fit_registration, judge
from eitbench.methods import Problem, create, methods
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.datasets import Dataset, load
from eitbench.scenarios.scenario import RecordedScenario, Scenario, SimulatedScenario

BUDGET = 24
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
    """The scenario whose validation split has the noise of the test split."""
    if isinstance(scenario, SimulatedScenario):
        noise = scenario.noise.model_copy(update={"validation": scenario.noise.test})
        return scenario.model_copy(update={"noise": noise})
    return scenario


def choose(scenario: Scenario, method: str) -> Choice | None:
    """The choice for `method` on `scenario`; None where it declares nothing to choose."""
    search = methods()[method].search
    if not search:
        return None
    seen = validation_scenario(scenario)
    # A recorded set's validation part is small and also fits the registration: all of it is used.
    limit = None if isinstance(scenario, RecordedScenario) else FRAMES
    data = load(seen, split="validation", limit=limit)
    if data.truth not in FIGURES or not len(data.voltages):
        return None
    problem = Problem(data.sensor, data.reference, _no_other_split)
    start = {name: getattr(create(method), name) for name in search}

    def evaluate(parameters: dict[str, Any]) -> float | None:
        try:
            candidate = create(method, **parameters)
            candidate.fit(problem)
            return ranked_figure(data, candidate.reconstruct(data.voltages.copy()))
        except Exception:
            return None  # a failed trial is recorded as such and cannot win

    return coordinate_search(search, start, evaluate)


def ranked_figure(data: Dataset, estimates: np.ndarray[Any, Any]) -> float | None:
    """The figure a scenario is ranked by, larger better; None where it is not finite."""
    estimates = np.asarray(estimates, dtype=np.float32)
    if data.truth == "position":
        rows = judge(data, estimates, fit_registration(data, estimates))
        value = -float(np.median(rows["localisation_mm"]))
    else:
        rows = judge(data, estimates)
        value = float(rows["cc" if data.truth == "classes" else "score"].mean())
    return value if np.isfinite(value) else None


def _no_other_split(split: str, limit: int | None) -> Dataset:
    raise RuntimeError(f"Selection does not load the {split} split.")


def record(scenario: Scenario, choices: Mapping[str, Choice], folder: Path) -> Path:
    """Add `choices` to the file of `scenario` in `folder`, keeping those of other methods."""
    path = folder / f"{scenario.name}.json"
    validation_hash = validation_scenario(scenario).data_hash("validation")
    content: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    if content.get("validation_hash") != validation_hash:
        content = {"choices": {}}
    kept = content["choices"] | {name: asdict(choice) for name, choice in choices.items()}
    content = {
        "scenario": scenario.name,
        "validation_hash": validation_hash,
        "rule": " ".join((__doc__ or "").split("\n\n", 1)[1].split()),
        "budget": BUDGET,
        "choices": dict(sorted(kept.items())),
    }
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def selected_parameters(scenario: Scenario, method: str) -> dict[str, Any] | None:
    """The recorded choice for `method` on `scenario`; None where there is none.

    The user's own choices (in the cache) come before the packaged ones. A choice counts only for
    the data it was made on: it is found by the hash of the validation split.
    """
    for folder in (cache_dir() / "selected", PACKAGED):
        path = folder / f"{scenario.name}.json"
        if not path.is_file():
            continue
        content = json.loads(path.read_text())
        if content["validation_hash"] != validation_scenario(scenario).data_hash("validation"):
            continue
        if method in content["choices"]:
            parameters: dict[str, Any] = content["choices"][method]["parameters"]
            return parameters
    return None
