"""Every built-in method keeps the contract, or says which check it fails by its nature."""

import pytest

from eitbench.benchmark.checks import check_method
from eitbench.benchmark.checks.method_under_test import OWN_GRID
from eitbench.methods.registry import METHOD_REGISTRY, methods

# A network is fitted to every frame: minutes on one core.
LONG = {"dip", "inr", "pinn", "cnn-pinn"}
# Shapes are sampled for every frame: seconds on one core, and the checks ask for many frames.
SAMPLED = {"shape-posterior"}
# Peers that share their code with one that is always checked.
ALIKE = {"pyeit-bp", "pyeit-greit"}

BUILT_IN = [name for name, cls in methods().items() if cls.__module__.startswith("eitbench.")]


def test_every_built_in_method_is_listed() -> None:
    assert len(BUILT_IN) >= len(METHOD_REGISTRY.built_in)
    assert set(BUILT_IN) >= LONG


def marks(name: str) -> list[pytest.MarkDecorator]:
    if name in LONG | ALIKE:
        return [pytest.mark.nightly, pytest.mark.timeout(1800)]
    if name in SAMPLED:
        return [pytest.mark.slow, pytest.mark.timeout(1200)]
    return [pytest.mark.slow]


@pytest.mark.parametrize("name", [pytest.param(name, marks=marks(name)) for name in BUILT_IN])
def test_a_built_in_method_keeps_the_contract(name: str) -> None:
    if why := methods()[name].unusable(OWN_GRID.nominal_sensor):
        pytest.skip(why)
    report = check_method(name, limit_s=300 if name in LONG | SAMPLED else 120)
    assert report.passed, [f"{result.name}: {result.message}" for result in report.failed]
