"""Suites: which scenarios are run with which methods or operators, read from TOML files."""

import difflib
import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from numpy.lib.stride_tricks import sliding_window_view
from pydantic import Field, ValidationError, ValidationInfo, field_validator

from eitbench.scenarios.declaration import Declaration
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.imperfections import Imperfections
from eitbench.scenarios.scenario import (
    Name,
    RecordedScenario,
    Scenario,
    SimulatedScenario,
    SplitNoise,
)

Key = tuple[str | int, ...]
WINDOW = 7
"""Side [pixels] of the windows that images are judged in; one must fit into the sensor."""
STANDARDISING = 2
"""Least number of validation samples that give every voltage a mean and a spread."""


class Suite(Declaration):
    """A suite, of either methods or operators.

    Attributes:
        name: registry name.
        title: one line for listings.
        description: what it is for, in a few sentences.
        methods: methods run when the user names none.
        operators: forward operators run when the user names none.
        scenarios: what they are run on.
        limit: number of test samples of each scenario when the user names none; all by default.
        fit_limit_s: a method or operator may take this long to set itself up on a scenario [s].
        frame_limit_s: it may take this long for one sample [s].
        download_limit_s: a recorded set may take this long to download [s]; no limit by default.
    """

    name: Name
    title: str
    description: str = ""
    methods: tuple[str, ...] | None = Field(default=None, min_length=1)
    operators: tuple[str, ...] | None = Field(default=None, min_length=1, validate_default=True)
    scenarios: tuple[Scenario, ...] = Field(min_length=1)
    limit: int | None = Field(default=None, ge=1)
    fit_limit_s: float = Field(default=600.0, gt=0, allow_inf_nan=False)
    frame_limit_s: float = Field(default=10.0, gt=0, allow_inf_nan=False)
    download_limit_s: float | None = Field(default=None, gt=0, allow_inf_nan=False)

    @field_validator("operators")
    @classmethod
    def _either(cls, value: tuple[str, ...] | None, info: ValidationInfo) -> tuple[str, ...] | None:
        # Methods that are wrong in themselves are missing here, and named already.
        if "methods" in info.data and (value is None) == (info.data["methods"] is None):
            raise ValueError("a suite lists either `methods` or `operators`")
        return value

    @field_validator("scenarios")
    @classmethod
    def _distinct(cls, value: tuple[Scenario, ...]) -> tuple[Scenario, ...]:
        names = [scenario.name for scenario in value]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"scenario {twice[0]!r} is declared twice")
        return value

    @property
    def ranks(self) -> Literal["methods", "operators"]:
        """What it ranks."""
        return "methods" if self.operators is None else "operators"

    @property
    def names(self) -> tuple[str, ...]:
        """The methods or operators run when the user names none."""
        return self.methods or self.operators or ()


def suites() -> dict[str, Path]:
    """The packaged suites: name to TOML file."""
    folder = Path(str(files("eitbench.scenarios"))) / "suite_files"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_suite(name: str | Path) -> Suite:
    """A packaged suite by name, or any suite by the path of its `.toml` file.

    Raises:
        InputError: unknown name (the nearest one is suggested), or a file that cannot be read or
            declares something wrong (the line and the field are named).
    """
    known = suites()
    if str(name) in known:
        return read_suite(known[str(name)])
    if Path(name).suffix == ".toml":
        return read_suite(Path(name))
    if Path(name).parent != Path():
        raise InputError(f"A suite file ends in .toml, got {str(name)!r}.")
    raise unknown_name("suite", str(name), known)


@cache
def scenarios() -> Mapping[str, SimulatedScenario | RecordedScenario]:
    """Every scenario of the packaged suites by name."""
    return {s.name: s for path in suites().values() for s in read_suite(path).scenarios}


def scenario_by_name(name: str) -> SimulatedScenario | RecordedScenario:
    """The packaged scenario called `name`.

    Raises:
        InputError: unknown name (the nearest one is suggested).
    """
    known = scenarios()
    if name not in known:
        raise unknown_name("scenario", name, known)
    return known[name]


def learned_from(scenario: Scenario) -> Scenario:
    """The scenario whose training split teaches methods for `scenario`.

    That is the scenario itself, but for recorded presses: these are learned from the simulated ones
    of the suite `presses`, on the nominal sensor of the set.
    """
    if isinstance(scenario, RecordedScenario) and scenario.recorded_set.truth == "position":
        presses = scenario_by_name("presses")
        return presses.model_copy(update={"sensor": scenario.recorded_set.sensor_name})
    return scenario


def read_suite(path: Path) -> Suite:
    """The suite declared in the TOML file at `path`.

    Raises:
        InputError: the file cannot be read or declares something wrong.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise InputError(f"Cannot read the suite file {path}: {reason}.") from error
    try:
        declared = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_syntax_message(path, text, str(error))) from error
    lines = key_lines(text)
    try:
        # Read as JSON, so that numbers written as text are refused but lists can be tuples.
        suite = Suite.model_validate_json(json.dumps(declared, default=_date), strict=True)
    except ValidationError as error:
        found = [_problem(dict(e), declared, lines) for e in error.errors(include_url=False)]
        # The first in the file, unless it is but the consequence of one further inside: a list of
        # nothing but mistakes also counts as too short.
        causes = [f for f in found if not any(g[1].startswith(f[1] + "[") for g in found)]
        line, field, problem = min(causes, key=lambda cause: cause[0])
        stop = "" if problem.endswith("?") else "."
        raise InputError(f"{_place(path, line, field)}: {problem}{stop}") from error
    for k, scenario in enumerate(suite.scenarios):
        unusable = _for_methods if suite.ranks == "methods" else _for_operators
        if wrong := unusable(scenario):
            name, problem = wrong
            place = _place(path, _line(("scenarios", k, name), lines), f"scenarios[{k}].{name}")
            raise InputError(f"{place}: {problem}.")
    return suite


def _date(value: object) -> dict[str, str]:
    """What stands for a date of TOML, which no field holds: not a string, which many do."""
    return {"date": str(value)}


def _for_operators(scenario: Scenario) -> tuple[str, str] | None:
    """The field and the reason why no operator could be judged on `scenario`, if so."""
    if isinstance(scenario, RecordedScenario):
        return "kind", "operators need a known conductivity, which only simulated scenarios have"
    if scenario.test < 1:
        return "test", "a suite judges operators on at least 1 test sample"
    if scenario.validation < STANDARDISING:
        return "validation", (
            f"voltages are standardised with at least {STANDARDISING} validation samples"
        )
    return None


def _for_methods(scenario: Scenario) -> tuple[str, str] | None:
    """The field and the reason why no method could be judged on `scenario`, if so."""
    if isinstance(scenario, RecordedScenario):
        return None
    if scenario.test < 1:
        return "test", "a suite judges methods on at least 1 test sample"
    # Every sensor holds a window of a fine grid, whose mask may be too large to look.
    if scenario.image_shape is None or min(scenario.image_shape) > 10 * WINDOW:
        return None
    mask = scenario.nominal_sensor.mask
    if (
        min(mask.shape) < WINDOW
        or not sliding_window_view(mask, (WINDOW, WINDOW)).all((2, 3)).any()
    ):
        return "image_shape", (
            f"no place of {WINDOW} x {WINDOW} pixels, as SSIM needs, lies inside the sensor: "
            "choose a finer grid"
        )
    return None


def declared_at(path: Path, field: str) -> str:
    """Where the suite file at `path` declares its `field`: the beginning of a sentence."""
    lines = key_lines(path.read_text(encoding="utf-8"))
    return _place(path, _line((field,), lines), field)


def _place(path: Path, line: int, field: str) -> str:
    return f"Suite file {path}, line {line}, field {field!r}"


def _line(key: Key, lines: Mapping[Key, int]) -> int:
    """The line of `key`, or of the nearest key that contains it."""
    while key not in lines:
        key = key[:-1]
    return lines[key]


def key_lines(text: str) -> dict[Key, int]:
    """The line (from 1) on which every key or table of a TOML `text` begins.

    A scan by line is enough to point at a mistake: keys inside inline tables and keys that look
    like text of a multi-line string are looked up at the nearest key that contains them.
    """
    lines: dict[Key, int] = {(): 1}
    counts: dict[str, int] = {}
    table: Key = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[\[\s*([\w-]+)\s*\]\]", line):
            counts[header[1]] = counts.get(header[1], -1) + 1
            table = (header[1], counts[header[1]])
            lines.setdefault((header[1],), number)
        elif header := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            parts: list[str | int] = []
            for part in header[1].split("."):
                parts.append(part)
                if part in counts and len(parts) == 1:
                    parts.append(counts[part])
            table = tuple(parts)
        elif entry := re.match(r"\s*\"?([\w.-]+)\"?\s*=", line):
            lines.setdefault((*table, *entry[1].split(".")), number)
            continue
        else:
            continue
        lines.setdefault(table, number)
    return lines


def _syntax_message(path: Path, text: str, reason: str) -> str:
    place = re.search(r"line (\d+)", reason)
    line = int(place[1]) if place else len(text.splitlines())
    what = reason.split(" (at ")[0]
    written = text.splitlines()[line - 1] if 0 < line <= len(text.splitlines()) else ""
    key = re.match(r"\s*([\w.-]+)\s*=", written)
    field = f", field {key[1]!r}" if key else ""
    return f"Suite file {path}, line {line}{field}: not valid TOML, {what[:1].lower()}{what[1:]}."


def _problem(
    error: Mapping[str, Any], declared: Mapping[str, Any], lines: Mapping[Key, int]
) -> tuple[int, str, str]:
    """Line, field and sentence of one validation `error`."""
    key = _declared_key(error["loc"], declared)
    field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in key).lstrip(
        "."
    )
    problem = str(error["msg"]).removeprefix("Value error, ").rstrip(".")
    if error["type"] == "missing":
        problem = "it is missing"
    elif error["type"] == "extra_forbidden":
        near = difflib.get_close_matches(str(key[-1]), _fields(), n=1)
        problem = f"unknown field, the nearest is {near[0]!r}" if near else "unknown field"
    elif error["type"].startswith("union_tag"):
        field = f"{field}.kind"
        problem = "it is 'simulated' or 'recorded'"
    return _line(key, lines), field, problem


def _declared_key(loc: Sequence[str | int], declared: Mapping[str, Any]) -> Key:
    """`loc` of a validation error without the union tags that the file does not have."""
    key: list[str | int] = []
    here: Any = declared
    for k, part in enumerate(loc):
        inside = part in here if isinstance(here, dict) else isinstance(here, list)
        if inside:
            here = here[part]
        elif k < len(loc) - 1:
            continue
        key.append(part)
    return tuple(key)


def _fields() -> list[str]:
    models: tuple[type[Declaration], ...]
    models = (Suite, SimulatedScenario, RecordedScenario, SplitNoise, Imperfections)
    return sorted({field for model in models for field in model.model_fields})
