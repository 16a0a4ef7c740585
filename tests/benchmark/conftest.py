"""What the tests of the runner share: a tiny suite, misbehaving methods, a cache of their own."""

from pathlib import Path

import pytest

from eitbench.scenarios.suites import Suite, load_suite

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="session")
def tiny() -> Suite:
    return load_suite(DATA / "tiny.toml")


@pytest.fixture(scope="session")
def toys() -> Path:
    return DATA / "toy_methods.py"


@pytest.fixture(scope="session")
def broken_contract() -> Path:
    return DATA / "broken_contract.py"
