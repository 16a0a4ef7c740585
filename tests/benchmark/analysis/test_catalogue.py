"""What eitbench says of its methods: their parameters are those that they take."""

import inspect
from typing import Any

import pytest

from eitbench.benchmark.analysis.catalogue import about_method, suite_options
from eitbench.methods.registry import OPERATOR_REGISTRY, place_methods
from eitbench.scenarios.suites.suite import load_suite, on_sensor

KNOWN: dict[str, Any] = {**place_methods(), **OPERATOR_REGISTRY.known()}
OURS = [name for name, cls in KNOWN.items() if cls.__module__.startswith("eitbench.methods.")]


@pytest.mark.parametrize("name", OURS)
def test_the_parameters_are_those_of_the_constructor(name: str) -> None:
    about = about_method(name)
    assert about is not None
    assert set(about.parameters) <= set(inspect.signature(KNOWN[name]).parameters)
    assert set(about.search) <= set(about.parameters)


def test_a_method_shows_its_parameters_and_their_defaults() -> None:
    about = about_method("eidors-noser")
    assert about is not None
    assert about.parameters == {"hyperparameter": "0.1", "exponent": "0.5"}


def test_a_command_names_the_sensor_that_a_suite_was_moved_to() -> None:
    suite = load_suite("quick")
    first = suite.scenarios[0].name
    moved = on_sensor(suite, "ohmc16")
    said = [suite_options(of.model_dump(mode="json"), first) for of in (suite, moved)]
    assert said == [["quick"], ["quick", "--sensor", "ohmc16"]]
    own = suite.model_dump(mode="json") | {"name": "mine"}
    assert suite_options(own, first) == ["mine.toml"]
    edited = suite.model_dump(mode="json")
    edited["scenarios"][0]["test"] += 1
    assert suite_options(edited, first) == ["quick.toml"]
