"""The contract checks find what they claim to find, and nothing else."""

from pathlib import Path

import pytest

from eitbench.benchmark.checks import check_target
from eitbench.benchmark.method_checks import CHECKS, check_method
from eitbench.scenarios.errors import InputError

EVERYTHING = set(CHECKS)
BROKEN = {
    "contract-kept": set(),
    "contract-contrast": {
        "zero contrast gives the background",
        "a conductive contact is positive",
    },
    "contract-inverted": {"a resistive contact is negative", "a conductive contact is positive"},
    "contract-unsigned": {"a conductive contact is positive"},
    "contract-batch": {"a batch equals its single frames"},
    "contract-random": {"the same twice"},
    "contract-short": {"refuses frames of the wrong length"},
    "contract-nan": {"refuses frames with NaN"},
}
REFUSES = {"refuses frames of the wrong length", "refuses frames with NaN"}
MISBEHAVING = {
    "toy-good": set(),
    "toy-prints": {"prints nothing"},
    "toy-fit-raises": EVERYTHING,
    "toy-hangs": EVERYTHING,
    "toy-raises": EVERYTHING,
    "toy-shape": EVERYTHING - REFUSES,
    "toy-complex": EVERYTHING - REFUSES,
    "toy-mutates": EVERYTHING - REFUSES,
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_promise_is_found_alone(name: str, broken_contract: Path) -> None:
    report = check_method(name, plugin=broken_contract)
    assert {result.name for result in report.failed} == BROKEN[name]
    assert len(report.results) == len(CHECKS)
    assert all(result.message.endswith(".") for result in report.failed)


@pytest.mark.parametrize("name", MISBEHAVING)
def test_a_misbehaving_method_fails_and_the_check_goes_on(name: str, toys: Path) -> None:
    report = check_method(name, plugin=toys, limit_s=0.5 if name == "toy-hangs" else 60)
    assert {result.name for result in report.failed} == MISBEHAVING[name]
    failed = len(MISBEHAVING[name])
    assert f"{len(CHECKS)} checks ran, {len(CHECKS) - failed} passed, {failed} failed" in (
        report.summary()
    )


def test_a_method_of_one_image_grid_is_checked_there(broken_contract: Path) -> None:
    report = check_method("contract-own-grid", plugin=broken_contract)
    assert report.where == "foam16, 80 x 80"
    assert not report.failed
    skipped = {result.name: result.message for result in report.having("skipped")}
    assert skipped == {
        "a conductive contact is positive": "on this sensor, conductivity can only fall."
    }


def test_an_unknown_method_suggests_the_nearest() -> None:
    with pytest.raises(InputError, match="Unknown method or operator 'nosr': did you mean 'noser'"):
        check_target("nosr")
