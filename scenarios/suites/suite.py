"""Suites: scenarios with the methods or operators to run on them, read from TOML files."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, ValidationInfo, field_validator
from scipy.ndimage import binary_erosion

from eitbench.scenarios.catalogue import is_file, sensor, sensors
from eitbench.scenarios.declaration import Declaration, Name, field_error, read_declaration
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.recordings import (
    RECORDED_SETS,
    RecordedSet,
    is_recording,
    recorded_set,
)
from eitbench.scenarios.suites.scenario import (
    RecordedScenario,
    Scenario,
    SimulatedScenario,
    TransferScenario,
)

MEMORY_LIMIT_MB = 8192.0
"""Memory that a method or operator may take where nothing else is declared [MiB]."""
WINDOW = 7
"""Side [pixels] of the windows of SSIM; one must fit into the sensor."""
STANDARDISING = 2
"""Least number of validation samples that give every voltage a mean and a spread."""


class Suite(Declaration):
    """A suite: it ranks methods that make images, methods of places, or operators.

    In a file, a table of the kind "transfer" may list `recordings`, and counts in `labelled`. It
    stands for a scenario of each recording with each count, called RECORDING-COUNT, with the name
    of its file for a recording of one's own. Their `others` are the rest of the list, unless the
    table names them.

    Attributes:
        title: one line for listings.
        description: its purpose, in a few sentences.
        methods: methods run when the user names none.
        operators: forward operators run when the user names none.
        scenarios: the scenarios that they are run on.
        limit: number of test samples of each scenario when the user names none; all by default.
        first: number of test samples of each scenario, the first ones, that methods get which are
            too slow for all, by name.
        fit_limit_s: a method or operator may take this long to set itself up on a scenario [s].
        frame_limit_s: it may take this long for one sample [s].
        memory_limit_mb: it may take this much memory, with the processes it starts [MiB].
        download_limit_s: a recorded set may take this long to download [s]; no limit by default.
    """

    name: Name
    title: str
    description: str = ""
    methods: tuple[str, ...] | None = Field(default=None, min_length=1)
    operators: tuple[str, ...] | None = Field(default=None, min_length=1, validate_default=True)
    scenarios: tuple[Scenario, ...] = Field(min_length=1)
    limit: int | None = Field(default=None, ge=1)
    first: dict[str, Annotated[int, Field(ge=1)]] = Field(default={}, validate_default=False)
    fit_limit_s: float = Field(default=600.0, gt=0, allow_inf_nan=False)
    frame_limit_s: float = Field(default=10.0, gt=0, allow_inf_nan=False)
    memory_limit_mb: float = Field(default=MEMORY_LIMIT_MB, gt=0, allow_inf_nan=False)
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
        if len({isinstance(scenario, TransferScenario) for scenario in value}) > 1:
            raise ValueError("scenarios of the kind 'transfer' stand in a suite of their own")
        by_name = {scenario.name: scenario for scenario in value}
        for scenario in value:
            if wrong := _unlike_familiar(scenario, by_name):
                raise ValueError(f"the familiar scenario of {scenario.name!r} {wrong}")
        return value

    @field_validator("first")
    @classmethod
    def _listed(cls, value: dict[str, int], info: ValidationInfo) -> dict[str, int]:
        listed = info.data.get("methods") or ()
        if other := sorted(value.keys() - set(listed)):
            raise ValueError(f"{other[0]!r} is none of the `methods` of the suite")
        if value and any(s.kind == "transfer" for s in info.data.get("scenarios", ())):
            raise ValueError("methods that say places get all presses")
        return value

    @property
    def ranks(self) -> Literal["methods", "places", "operators"]:
        """The kind of entries that the suite ranks: images, places or forward operators."""
        if self.operators is not None:
            return "operators"
        return "places" if isinstance(self.scenarios[0], TransferScenario) else "methods"

    def familiar(self, scenario: Scenario) -> Scenario:
        """The scenario whose data methods learn and are tuned on: mostly `scenario` itself."""
        if isinstance(scenario, TransferScenario) or not scenario.familiar:
            return scenario
        return next(known for known in self.scenarios if known.name == scenario.familiar)

    def recordings(self, scenario: Scenario) -> tuple[RecordedSet, ...]:
        """The recorded sets that a run of one of its scenarios reads; none where all is simulated.

        (A set may name a further one for validation, which is fetched with it.)
        """
        if isinstance(scenario, TransferScenario):
            return tuple(map(recorded_set, (scenario.recording, *scenario.others)))
        both = (scenario, self.familiar(scenario))
        return tuple(of.recorded_set for of in both if isinstance(of, RecordedScenario))

    @property
    def names(self) -> tuple[str, ...]:
        """The methods or operators run when the user names none."""
        return self.methods or self.operators or ()


def _unlike_familiar(scenario: Scenario, by_name: Mapping[str, Scenario]) -> str:
    """What is wrong with the familiar scenario of `scenario`; "" if nothing is."""
    if isinstance(scenario, TransferScenario) or not scenario.familiar:
        return ""
    known = by_name.get(scenario.familiar)
    if known is None or isinstance(known, TransferScenario):
        return f"is {scenario.familiar!r}, and the suite declares {', '.join(by_name)}"
    if known == scenario:
        return "is the scenario itself"
    if known.familiar:
        return f"is {known.name!r}, which names a familiar one itself"
    if known.nominal_sensor != scenario.nominal_sensor:
        return f"is {known.name!r}, whose sensor, image or range of conductivity is another"
    return ""


def suites() -> dict[str, Path]:
    """The packaged suites: name to TOML file."""
    folder = Path(str(files("eitbench.scenarios.suites"))) / "suite_files"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_suite(name: str | Path) -> Suite:
    """A packaged suite by name, or any suite by the path of its `.toml` file.

    Raises:
        InputError: unknown name (the nearest one is suggested), a folder, or a file that cannot be
            read or declares something wrong (the field is named).
    """
    known = suites()
    if str(name) in known:
        return read_suite(known[str(name)])
    if Path(name).suffix == ".toml":
        return read_suite(Path(name))
    if Path(name).is_dir():
        raise InputError(
            f"{name} is a folder: give the name of a suite, or a file that ends in .toml."
        )
    if Path(name).parent != Path():
        raise InputError(f"A suite file ends in .toml, got {str(name)!r}.")
    raise unknown_name("suite", str(name), known)


def on_sensor(suite: Suite, name: str) -> Suite:
    """Return the suite with its simulated scenarios on another sensor, and no recorded ones.

    Args:
        suite: any that has simulated scenarios.
        name: of a sensor or of a recorded set, whose sensor it is; or the path of a sensor file
            (.toml) or of a recording (.h5).

    Raises:
        InputError: unknown name, no simulated scenario, a sensor that one of them cannot use, or
            one that is told apart from a recorded scenario.
    """
    if name not in sensors() and not is_file(name) and name in RECORDED_SETS:
        name = recorded_set(name).sensor_name
    sensor(name)
    found = []
    for scenario in suite.scenarios:
        if not isinstance(scenario, SimulatedScenario):
            continue
        declared = scenario.model_dump(mode="json") | {"sensor": name, "image_shape": None}
        try:
            moved = SimulatedScenario.model_validate(declared).drawn_with(scenario.key("test"))
        except ValidationError as error:
            reason = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
            raise InputError(f"Suite {suite.name!r} cannot use sensor {name!r}: {reason}") from None
        if wrong := _unusable(moved, suite.ranks):
            raise InputError(f"Suite {suite.name!r} cannot use sensor {name!r}: {wrong[1]}.")
        found.append(moved)
    if not found:
        raise InputError(
            f"Suite {suite.name!r} has no simulated scenario, so it has the sensors of its "
            "recordings: leave --sensor out."
        )
    return _of_these(suite, found)


def drawn_with(suite: Suite, key: bytes) -> Suite:
    """Return the scenarios of `suite` whose test split is drawn, drawn with the secret `key`.

    Raises:
        InputError: there is none: recordings and designs are what they are.
    """
    drawn = tuple(
        scenario.drawn_with(key)
        for scenario in suite.scenarios
        if isinstance(scenario, SimulatedScenario) and scenario.acuity is None
    )
    if not drawn:
        raise InputError(
            f"Suite {suite.name!r} has no hidden set: its frames are recordings or a design, and "
            "no key draws them. Name a suite of simulated touches."
        )
    return _of_these(suite, drawn)


def _of_these(suite: Suite, scenarios: Sequence[Scenario]) -> Suite:
    """The suite with these scenarios only.

    Raises:
        InputError: one has a familiar scenario that is not among them.
    """
    by_name = {scenario.name: scenario for scenario in scenarios}
    for scenario in scenarios:
        if wrong := _unlike_familiar(scenario, by_name):
            raise InputError(
                f"In suite {suite.name!r} the familiar scenario of {scenario.name!r} {wrong} here: "
                "it cannot be run so."
            )
    return suite.model_copy(update={"scenarios": tuple(scenarios)})


def hidden_key(suite: Suite) -> str:
    """Return the SHA-256 (hex) of the key that a hidden suite is drawn with; "" of an open one."""
    return next((s.hidden for s in suite.scenarios if isinstance(s, SimulatedScenario)), "")


@cache
def scenarios() -> Mapping[str, SimulatedScenario | RecordedScenario]:
    """Every scenario of the packaged suites by name, but for those of the kind "transfer"."""
    return {
        scenario.name: scenario
        for path in suites().values()
        for scenario in read_suite(path).scenarios
        if not isinstance(scenario, TransferScenario)
    }


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
    """The scenario whose training split methods learn from for `scenario`.

    That is the scenario itself, but for recorded presses: these are learned from the simulated ones
    of the suite `presses`, on the nominal sensor of the set.
    """
    if isinstance(scenario, TransferScenario):
        scenario = scenario.recorded
    if isinstance(scenario, RecordedScenario) and scenario.recorded_set.truth == "position":
        presses = scenario_by_name("presses")
        return presses.model_copy(update={"sensor": scenario.recorded_set.sensor_name})
    return scenario


def has_training(scenario: Scenario) -> bool:
    """True if methods can learn from a training split for `scenario`; see `learned_from`."""
    return not isinstance(learned_from(scenario), RecordedScenario)


def read_suite(path: Path) -> Suite:
    """The suite declared in the TOML file at `path`; errors as those of `load_suite`."""
    suite = read_declaration("Suite", path, Suite, partial(_with_each_transfer, path))
    for k, scenario in enumerate(suite.scenarios):
        if wrong := _unusable(scenario, suite.ranks):
            field, problem = wrong
            key = ("scenarios", k, field)
            raise field_error("Suite", path, key, f"{problem}.", scenario.name)
    return suite


def _with_each_transfer(path: Path, declared: dict[str, Any]) -> dict[str, Any]:
    """The declaration with a scenario for each of the `recordings` of a table and each count."""
    tables = declared.get("scenarios")
    if not isinstance(tables, list):
        return declared
    found: list[Any] = []
    for k, table in enumerate(tables):
        if not isinstance(table, dict) or "recordings" not in table:
            found.append(table)
            continue
        for name, example in (("recordings", '["first.h5", "second.h5"]'), ("labelled", "[0, 25]")):
            if not (isinstance(table.get(name), list) and table[name]):
                key = ("scenarios", k, name)
                raise field_error("Suite", path, key, f"a list is needed, such as {example}.")
        recordings, counts = table["recordings"], table["labelled"]
        names = _short_names(recordings)
        rest = {name: value for name, value in table.items() if name != "recordings"}
        found += [
            {"others": [other for other in recordings if other != recording]}
            | rest
            | {"name": f"{name}-{count}", "recording": recording, "labelled": count}
            for name, recording in zip(names, recordings, strict=True)
            for count in counts
        ]
    return declared | {"scenarios": found}


def _short_names(recordings: Sequence[object]) -> list[object]:
    """The names of files as names of scenarios may be, each once; public sets as they are."""
    names: list[object] = []
    for k, recording in enumerate(recordings):
        name = recording
        if isinstance(recording, str) and is_recording(recording):
            plain = unicodedata.normalize("NFKD", Path(recording).stem.lower())
            plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
            name = re.sub("[^a-z0-9]+", "-", plain).strip("-") or f"recording-{k}"
        names.append(f"{name}-{k}" if name in names else name)
    return names


def _unusable(scenario: Scenario, ranks: str) -> tuple[str, str] | None:
    """The field and the reason why no method or operator can be evaluated on `scenario`, if so."""
    operators = ranks == "operators"
    if operators and not isinstance(scenario, SimulatedScenario):
        return "kind", "operators need a known conductivity, which only simulated scenarios have"
    if isinstance(scenario, TransferScenario):
        if scenario.same_skin:
            return "others", scenario.same_skin.removesuffix(".")
        scenario = scenario.recorded.model_copy(update={"name": scenario.name})
    if isinstance(scenario, RecordedScenario):
        # Tables show this name alone, and no table may pass an emulated board for a real one.
        if scenario.recorded_set.emulated and "emulated" not in scenario.name:
            return "name", (
                f"{scenario.recording} was recorded from an emulated board, so its name must say "
                f"so: 'emulated-{scenario.name}'"
            )
        return None
    if scenario.test < 1:
        return "test", f"a suite needs at least 1 test sample to evaluate {ranks} on"
    if operators and scenario.validation < STANDARDISING:
        return "validation", (
            f"at least {STANDARDISING} validation samples are needed to standardise voltages"
        )
    window = np.ones((WINDOW, WINDOW), dtype=bool)
    if not operators and not binary_erosion(scenario.nominal_sensor.mask, window).any():
        return "image_shape", (
            f"no place of {WINDOW} x {WINDOW} pixels, as SSIM needs, lies inside the sensor: "
            "choose a finer grid"
        )
    return None
