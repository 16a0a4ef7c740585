"""What eitbench itself says of a method or a recording: description, code, training, files."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from eitbench.methods.registry import OPERATOR_REGISTRY, place_methods
from eitbench.scenarios.catalogue import sensors
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.recordings import RECORDED_SETS
from eitbench.scenarios.recordings.descriptors import RecordedSet
from eitbench.scenarios.suites.suite import load_suite, suites

Recording = RecordedSet
"""The descriptor of a recorded set."""

TRAINING = {
    "scenario": "Trained on", "train_samples": "Samples", "epochs": "Epochs", "seed": "Seed",
    "device": "Device", "train_s": "Time [s]", "command": "Command",
    "train_data": "Hash of the data",
}  # fmt: skip
"""What is shown of the training behind packaged weights, by the entry of their file: its name."""


@dataclass(frozen=True)
class AboutMethod:
    """A method or operator of eitbench.

    Attributes:
        description: its first sentence.
        module: the path of its code in the repository.
        code: that code.
        parameters: their names and defaults, as text: what `eitbench run --parameters` takes.
        search: the values that tuning tries, by parameter, as text.
        failures: checks of `eitbench check` that it fails by its nature, and why.
        states: what it says beside its images, such as "uncertainty".
        trained: by sensor and name, entries `TRAINING` of its packaged weights that are known.
    """

    description: str
    module: str
    code: str
    parameters: Mapping[str, str]
    search: Mapping[str, str]
    failures: Mapping[str, str]
    states: tuple[str, ...]
    trained: Mapping[str, Mapping[str, str]]


def about_method(name: str) -> AboutMethod | None:
    """What is known of a method or operator; None for one that is not eitbench's."""
    known: dict[str, Any] = {**place_methods(), **OPERATOR_REGISTRY.known()}
    cls = known.get(name)
    if cls is None or not cls.__module__.startswith("eitbench.methods."):
        return None
    return AboutMethod(
        description=first_line(cls),
        module=cls.__module__.removeprefix("eitbench.").replace(".", "/") + ".py",
        code=Path(inspect.getfile(cls)).read_text(encoding="utf-8"),
        parameters={
            field.name: repr(field.default)
            for field in (dataclasses.fields(cls) if dataclasses.is_dataclass(cls) else ())
            if field.init and field.default is not dataclasses.MISSING
        },
        # Operators have neither.
        search={
            key: ", ".join(map(str, values)) for key, values in getattr(cls, "search", {}).items()
        },
        failures=dict(getattr(cls, "expected_failures", {})),
        states=tuple(
            what
            for what in ("uncertainty", "novelty")
            if getattr(cls, f"states_{what}", lambda: False)()
        ),
        trained=_trained(name),
    )


def _trained(name: str) -> dict[str, dict[str, str]]:
    """Entries of the metadata of packaged weights, by the name of their sensor."""
    found = {}
    for file in files("eitbench.methods.weights").iterdir():
        match = re.fullmatch(rf"{re.escape(name)}-(.+)-[0-9a-f]{{12}}\.json", file.name)
        if match and match[1] in sensors():
            about = json.loads(file.read_text(encoding="utf-8"))
            found[match[1]] = {n: str(about[key]) for key, n in TRAINING.items() if key in about}
    return dict(sorted(found.items()))


def packaged_suites() -> list[str]:
    """Names of the suites that come with eitbench."""
    return sorted(suites())


@cache  # every row of a report asks
def _packaged(suite: str) -> dict[str, dict[str, Any]]:
    """The scenarios of a packaged suite by name, as a manifest describes them."""
    return {of.name: of.model_dump(mode="json") for of in load_suite(suite).scenarios}


def suite_options(declared: Mapping[str, Any], scenario: str) -> list[str]:
    """The words of a command that name a suite, and the sensor that it was moved to.

    A suite of a user's own stands there as a file of its name, and so does one that has the name
    of a packaged suite, but declares the scenario otherwise.

    Args:
        declared: the suite, as a manifest describes it.
        scenario: the name of one of its scenarios.
    """
    name = str(declared["name"])
    if name not in suites():
        return [f"{name}.toml"]
    here: Mapping[str, Any] = {of["name"]: of for of in declared["scenarios"]}.get(scenario, {})
    ours = _packaged(name).get(scenario, {})
    other = {key for key, value in here.items() if ours.get(key) != value}
    if not other:
        return [name]
    if "sensor" in other and other <= {"sensor", "image_shape"}:
        return [name, "--sensor", Path(here["sensor"]).name]
    return [f"{name}.toml"]


def about_recording(name: str) -> Recording | None:
    """The descriptor of a public recorded set; None for a recording of one's own."""
    return RECORDED_SETS.get(name)
