"""Records of hyper-parameters that were selected on validation data."""

import json
import logging
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from eitbench.benchmark.metrics.evaluation import REGISTRATION_FRAMES
from eitbench.methods.registry import methods
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import content_hash
from eitbench.scenarios.storage.atomic_write import atomic_write_json
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario, SimulatedScenario

_log = logging.getLogger(__name__)

PACKAGED = Path(__file__).parent / "selected"
FRAMES = 36
"""Validation samples of simulated scenarios that a set of parameters is scored on."""
P_WORSE = 0.02
"""A trial is given up where Wilcoxon's signed-rank test of its frames against those of the best
trial has a smaller p-value."""
RULE = (
    "Coordinate search over the values that a method declares in `search`, from its defaults, then "
    "seeded TPE for what is left of the budget of trials and seconds, which is the same for every "
    f"method; each trial scored on the first {FRAMES} validation samples ({REGISTRATION_FRAMES} of "
    "a recorded set) with the noise of the test split (of a rung of the ladder and of acuity, that "
    "of the validation split), by the figure the scenario is ranked by, "
    f"and given up where the samples so far say by Wilcoxon's test (p < {P_WORSE}) that it is "
    "worse than the best. The test split is never loaded."
)

EndedBy = Literal["trials", "seconds", "space"]
TrialStatus = Literal["ok", "pruned", "failed"]


@dataclass(frozen=True)
class TuningBudget:
    """Budget of a study; whichever limit is reached first ends it.

    Attributes:
        trials: sets of parameters.
        seconds: time in the method [s], set-up and failed trials included.
    """

    trials: int = 16
    seconds: float = 1200.0

    def __post_init__(self) -> None:
        """Raise InputError for a time that is not finite: it is the same for every method."""
        if not math.isfinite(self.seconds):
            raise InputError(f"A budget is a finite number of seconds, got {self.seconds}.")


@dataclass(frozen=True)
class Trial:
    """One set of parameters.

    Attributes:
        figure: on all validation samples, larger better; None where it was pruned or failed.
        status: "pruned" where it was given up as clearly worse than the best.
        seconds: its time [s].
        message: reason of its failure; "" where it did not fail.
    """

    parameters: dict[str, Any]
    figure: float | None
    status: TrialStatus = "ok"
    seconds: float = 0.0
    message: str = ""


@dataclass(frozen=True)
class Selection:
    """Parameters selected for one method, with every trial that led to them and their cost.

    Attributes:
        figure: of the parameters; None where no trial gave one.
        ended_by: the limit that ended the search, or "space" where all of the space was tried.
        once_for: names of the scenarios that share the selection; empty for a single one.
        ranked_by: the metric that the figures are of, times its sign; "" for a mean of several
            scenarios, each scaled.
        code: SHA-256 (hex) of the file of a method of somebody else, see `Plan.code`.
    """

    parameters: dict[str, Any]
    figure: float | None
    trials: tuple[Trial, ...]
    budget: TuningBudget
    ended_by: EndedBy
    once_for: tuple[str, ...] = ()
    ranked_by: str = ""
    code: str = ""

    def describe(self) -> dict[str, Any]:
        """Return plain values for a record."""
        plain = asdict(self)
        statuses = [trial.status for trial in self.trials]
        spent = {
            "trials": len(statuses),
            "pruned": statuses.count("pruned"),
            "failed": statuses.count("failed"),
            "seconds": round(sum(trial.seconds for trial in self.trials), 2),
            "ended_by": plain.pop("ended_by"),
        }
        for trial in plain["trials"]:
            trial["seconds"] = round(trial["seconds"], 3)
            if not trial["message"]:
                del trial["message"]
        return {**plain, "spent": spent}


def at_edge(selection: Mapping[str, Any]) -> list[str]:
    """Return the parameters whose selected value is the least or the greatest that was tried.

    A better value may lie beyond; but nothing lies below 0.

    Args:
        selection: as `Selection.describe` gives it.
    """
    edges = []
    for name, value in selection["parameters"].items():
        tried = [trial["parameters"].get(name) for trial in selection["trials"]]
        numbers = [v for v in tried if isinstance(v, int | float) and not isinstance(v, bool)]
        if len(set(numbers)) >= 2 and value != 0 and value in (min(numbers), max(numbers)):
            edges.append(name)
    return edges


def validation_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario whose validation split has the noise of the test split.

    A rung of the ladder from simulation to reality is tuned on what its user can simulate: the
    nominal sensor with the noise that is declared for the validation split. So is acuity, which has
    several levels of noise.
    """
    if isinstance(scenario, SimulatedScenario) and not scenario.ladder and scenario.acuity is None:
        noise = scenario.noise.model_copy(update={"validation": scenario.noise.test})
        return scenario.model_copy(update={"noise": noise})
    return scenario


def validation_key(scenario: Scenario) -> str:
    """Return the SHA-256 (hex) of sensor, validation phantoms and noise, or of the recorded set.

    Scenarios that differ in name, in sample numbers or in their test phantoms share their
    selections, and so do a nominal and a calibrated one: their calibration alone is compared.
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
    assert isinstance(seen, RecordedScenario)  # what says places is not tuned
    # A recording of one's own that is renamed is the same data.
    of = seen.recorded_set
    named = {"name": "own" if of.own else of.name, "calibrated": False}
    return seen.model_copy(update=named).data_hash("validation")


def record(scenario: Scenario, selections: Mapping[str, Selection], folder: Path) -> Path:
    """Add `selections` to the file for the data of `scenario` in `folder`.

    A selection that was made by another rule than `RULE` keeps it.
    """
    key = validation_key(scenario)
    path = folder / f"{key[:16]}.json"
    added = {name: selection.describe() for name, selection in selections.items()}
    before, rule = _records(path)
    if rule != RULE:
        before = {name: {"rule": rule} | selection for name, selection in before.items()}
    content = {
        "made_on": scenario.name,
        "validation_key": key,
        "rule": RULE,
        "choices": dict(sorted((before | added).items())),
    }
    atomic_write_json(path, content)
    return path


def recorded_selection(scenario: Scenario, method: str, code: str = "") -> dict[str, Any] | None:
    """Return the record of the selection for `method` on data like `scenario`'s; None without one.

    It was made with the same `code`, see `Selection`. The user's own selections (in the cache) come
    before the packaged ones.
    """
    made = _made_on(scenario, method)
    return next((selection for selection in made if selection.get("code", "") == code), None)


def outdated_selection(scenario: Scenario, method: str, code: str) -> bool:
    """True if all records of selections for `method` on such data were made with other code."""
    return bool(_made_on(scenario, method)) and recorded_selection(scenario, method, code) is None


def _made_on(scenario: Scenario, method: str) -> list[dict[str, Any]]:
    file = f"{validation_key(scenario)[:16]}.json"
    records = [_records(folder / file)[0] for folder in (user_selections(), PACKAGED)]
    known = methods().get(method)
    name = (known and known.tuned_as) or method
    return [of[name] for of in records if name in of]


def selected_parameters(scenario: Scenario, method: str) -> dict[str, Any] | None:
    """Return the parameters of `recorded_selection`; None without one."""
    selection = recorded_selection(scenario, method)
    return None if selection is None else selection["parameters"]


class _StoredTrial(BaseModel):
    parameters: dict[str, Any]
    status: TrialStatus


class _StoredSelection(BaseModel):
    parameters: dict[str, Any]
    trials: list[_StoredTrial]
    spent: dict[str, float | str]
    code: str = ""


class _Records(BaseModel):
    """What is used of a file of selections."""

    rule: str
    choices: dict[str, _StoredSelection]


def _records(path: Path) -> tuple[dict[str, Any], str]:
    """The records in a file by method, and their rule; a damaged one is named, counts as empty."""
    if not path.is_file():
        return {}, RULE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        _Records.model_validate(content)
    except (ValueError, RecursionError):
        _log.warning("%s is damaged and is not used: delete it and tune again.", path)
        return {}, RULE
    return content["choices"], content["rule"]


def user_selections() -> Path:
    """Return the folder of the user's own selections."""
    return cache_dir() / "selected"
