"""The contract checks find what they claim to find, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.checks.checking import SkippedError
from eitbench.benchmark.checks.method_checks import CHECKS, check_method
from eitbench.benchmark.checks.method_physics import mirror, rotation
from eitbench.benchmark.checks.method_under_test import SCENARIO, MethodUnderTest
from eitbench.benchmark.checks.targets import check_target
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model

EVERYTHING = set(CHECKS)
BROKEN = {
    "contract-kept": set(),
    "contract-contrast": {
        "zero contrast gives the background",
        "a conductive contact is positive",
        "small contrasts are nearly linear",
    },
    "contract-inverted": {"a resistive contact is negative", "a conductive contact is positive"},
    "contract-unsigned": {"a conductive contact is positive"},
    "contract-batch": {"a batch equals its single frames"},
    "contract-random": {"the same twice"},
    "contract-short": {"refuses frames of the wrong length"},
    "contract-nan": {"refuses frames with NaN"},
    "contract-order": {"the order of frames does not matter"},
    "contract-seed": {"the global seed does not matter"},
    "contract-leak": {"leaves the global random state alone"},
    "contract-saturated": {"small contrasts are nearly linear"},
    "contract-squared": {"small contrasts are nearly linear"},
    "contract-turned": {"rotation equivariance"},
    "contract-mirrored": {"mirror equivariance"},
    "contract-gain": {"gain invariance"},
    "contract-exploding": {"noise is not blown up"},
    "contract-diverging": {"noise is not blown up"},
    "contract-overconfident": {"noise is not blown up"},
    "contract-threads": {"the thread count does not matter"},
    "contract-keeps": {"memory does not grow"},
    "contract-network": {"uses no network"},
    "contract-writes": {"writes nothing elsewhere"},
    "contract-starts": {"starts no other program"},
}
# Other ways to break what another toy breaks already.
MORE = {"contract-squared", "contract-diverging", "contract-overconfident"}
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


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in MORE else n for n in BROKEN]
)
def test_a_broken_promise_is_found_alone(
    name: str, broken_contract: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOY_DIARY", str(tmp_path / "diary"))
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


def test_a_hole_is_found(broken_contract: Path) -> None:
    report = check_method("contract-hole", plugin=broken_contract)
    (found,) = (result for result in report.failed if result.name == "returns finite values")
    assert found.message == "3 of 4800 pixels are NaN or infinite."


def test_a_method_that_will_not_stop_is_stopped_at_the_limit(broken_contract: Path) -> None:
    subject_model = SCENARIO.nominal_sensor
    forward_model(subject_model).jacobian(np.ones(subject_model.image_shape))  # compiles it
    report = check_method("contract-slow", plugin=broken_contract, limit_s=8)
    (found,) = report.failed
    assert found.name == "answers within the time limit"
    assert found.message == "reconstruct took longer than 8 s."


def test_an_expected_failure_is_none_and_keeps_its_reason(broken_contract: Path) -> None:
    report = check_method("contract-excused", plugin=broken_contract)
    (found,) = report.having("xfail")
    assert found.name == "rotation equivariance"
    assert found.message.endswith("0.01 is allowed. Expected: sees more at the top.")
    assert report.passed
    assert report.counts["xfail"] == 1
    assert "0 failed, 1 failed as expected." in report.summary()


def test_an_expected_failure_that_passes_fails(broken_contract: Path) -> None:
    report = check_method("contract-outdated", plugin=broken_contract)
    (found,) = report.failed
    assert found.name == "rotation equivariance"
    assert found.message == (
        "it passes although it is expected to fail (saw more at the top): remove it."
    )


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("contract-no-such-check", "did you mean 'rotation equivariance'"),
        ("contract-no-reason", "'rotation equivariance' but gives no reason: say why."),
        ("contract-no-mapping", "should map names of checks to reasons."),
    ],
)
def test_an_expected_failure_needs_a_check_and_a_reason(
    name: str, sentence: str, broken_contract: Path
) -> None:
    with pytest.raises(InputError, match=sentence):
        check_method(name, plugin=broken_contract)


def test_a_sensor_that_no_motion_brings_onto_itself_has_none_to_check(tmp_path: Path) -> None:
    subject = MethodUnderTest(SCENARIO, "back-projection", None, 60, tmp_path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MethodUnderTest, "motions", subject.motions[:1])
        for check in (rotation, mirror):
            with pytest.raises(SkippedError, match="brings this sensor onto itself"):
                check(subject)


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
