"""What eitbench says of its methods: their parameters are those that they take."""

import inspect
from typing import Any

import pytest

from eitbench.benchmark.analysis.catalogue import about_method
from eitbench.methods.registry import OPERATOR_REGISTRY, place_methods

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
