"""Checks of methods of places: those that are built in pass, broken ones fail the right check."""

from pathlib import Path

import pytest

from eitbench.benchmark import InputError
from eitbench.benchmark.checks.check import check_place_method, check_target

BROKEN = """
import numpy as np
from eitbench.methods import PlaceMethod, register_place_method

@register_place_method("guesses")
class Guesses(PlaceMethod):
    def fit(self, problem):
        self.problem = problem
        labelled = problem.labelled
        self.middle = labelled.places.sum(axis=0) / (len(labelled) or np.nan)

    def locate(self, differences):
        return np.tile(self.middle, (len(self.problem.unit(differences)), 1))

@register_place_method("careless")
class Careless(Guesses):
    def locate(self, differences):
        np.random.rand()
        return np.zeros((len(differences), 3))
"""


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plugin") / "broken.py"
    path.write_text(BROKEN)
    return path


@pytest.mark.slow
def test_a_regression_passes() -> None:
    (report,) = check_target("kernel-ridge")
    assert report.passed
    assert report.kind == "place method"
    assert len(report.results) == 20


@pytest.mark.slow
def test_broken_methods_fail_the_right_checks(plugin: Path) -> None:
    guesses = check_place_method("guesses", plugin=plugin)
    assert {result.check for result in guesses.failed} == {"learns", "without_labelled"}
    careless = check_place_method("careless", plugin=plugin)
    failed = {result.check: result.message for result in careless.failed}
    assert "(40, 3) instead of (40, 2)" in failed["shape"]
    assert {"wrong_length", "nan_differences"} <= failed.keys()


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name",
    ["one-place", "ridge", "kernel-ridge-skins", "network", "network-simulated", "network-skins"],
)
def test_every_built_in_method_of_places_passes(name: str) -> None:
    assert check_place_method(name).passed


def test_an_unknown_method_is_named() -> None:
    with pytest.raises(InputError, match="kernel-ridge"):
        check_place_method("kernel-rige")
