"""The contract checks find what they claim to find, and nothing else."""

from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.checks.check import METHOD_CHECKS, check_method, check_target
from eitbench.benchmark.checks.harness import BrokenError, SkippedError, require_quiet
from eitbench.benchmark.checks.method_checks import mirror_equivariance, rotation_equivariance
from eitbench.benchmark.checks.method_under_test import SCENARIO, MethodUnderTest
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model

PLUGIN = Path(__file__).parents[1] / "data" / "broken_contract.py"
EVERYTHING = {check.__name__ for check in METHOD_CHECKS}
BROKEN = {
    "contract-kept": set(),
    "contract-contrast": {"zero_contrast", "conductive_contact", "linearity"},
    "contract-inverted": {"resistive_contact", "conductive_contact"},
    "contract-unsigned": {"conductive_contact"},
    "contract-batch": {"batch_equals_single"},
    "contract-random": {"deterministic"},
    "contract-short": {"wrong_length"},
    "contract-nan": {"nan_voltages"},
    "contract-order": {"order"},
    "contract-seed": {"seed"},
    "contract-leak": {"random_state"},
    "contract-saturated": {"linearity"},
    "contract-squared": {"linearity"},
    "contract-turned": {"rotation_equivariance"},
    "contract-mirrored": {"mirror_equivariance"},
    "contract-gain": {"gain_invariance"},
    "contract-reference": {"new_reference"},
    "contract-exploding": {"noise_growth"},
    "contract-diverging": {"noise_growth"},
    "contract-overconfident": {"noise_growth"},
    "contract-threads": {"threads"},
    "contract-late": set(),
    "contract-doubts": set(),
    "contract-wary": set(),
    "contract-compares": {"novelty"},
    "contract-in-volts": {"novelty"},
    "contract-speechless": {"novelty"},
    "contract-indifferent": {"novelty"},
    "contract-negative": {"uncertainty"},
    "contract-certain": {"uncertainty"},
    "contract-beyond": {"uncertainty"},
    "contract-few": {"uncertainty"},
    "contract-wavering": {"uncertainty"},
    "contract-neighbour": {"uncertainty"},
    "contract-keeps": {"memory"},
    "contract-network": {"no_network"},
    "contract-writes": {"no_writing"},
    "contract-starts": {"no_programs"},
}
# Other ways to break what another toy breaks already.
MORE = {
    "contract-squared", "contract-diverging", "contract-overconfident", "contract-certain",
    "contract-few", "contract-wavering", "contract-in-volts", "contract-speechless",
    "contract-indifferent",
}  # fmt: skip
MISBEHAVING = {"toy-good": set(), "toy-prints": {"quiet"}}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.nightly) if n in MORE else n for n in BROKEN]
)
def test_a_broken_promise_is_found_alone(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOY_DIARY", str(tmp_path / "diary"))
    report = check_method(name, plugin=PLUGIN)
    assert {result.check for result in report.failed} == BROKEN[name]
    assert len(report.results) == len(EVERYTHING)
    assert all(result.message.endswith(".") for result in report.failed)


def test_what_is_printed_is_found_after_text_of_more_bytes_than_characters(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("σ = 0.12 S/m, µ and λ are chosen\n" * 20, encoding="utf-8")

    def prints() -> None:
        with log.open("a", encoding="utf-8") as file:
            file.write("σ = 0.1\n")

    require_quiet(log, lambda: None, "it")
    with pytest.raises(BrokenError, match=r"it prints: 'σ = 0\.1'"):
        require_quiet(log, prints, "it")


@pytest.mark.parametrize("name", MISBEHAVING)
def test_a_misbehaving_method_fails_and_the_check_goes_on(name: str, toys: Path) -> None:
    report = check_method(name, plugin=toys)
    assert {result.check for result in report.failed} == MISBEHAVING[name]
    failed = len(MISBEHAVING[name])
    ran = len(EVERYTHING) - 2  # it states neither uncertainty nor novelty
    said = f"{ran} checks ran, {ran - failed} passed, {failed} failed, 2 skipped."
    assert said in report.summary()


@pytest.mark.parametrize(
    ("name", "check", "says", "line"),
    [
        (
            "toy-fit-raises",
            "shape",
            "set-up failed with ValueError: no licence for this sensor.",
            'in fit\n    raise ValueError("no licence',
        ),
        pytest.param(
            "toy-hangs", "shape", "reconstruct took longer than 10 s.", "", marks=pytest.mark.slow
        ),
        ("toy-raises", "shape", "RuntimeError: the sky is falling.", "in fail"),
        ("toy-shape", "shape", "reconstruct returned an array of shape", ""),
        ("toy-mutates", "unchanged_input", "reconstruct changed its input in place.", ""),
    ],
)
def test_a_method_that_does_not_work_at_all_is_told_so_once(
    name: str, check: str, says: str, line: str, toys: Path
) -> None:
    report = check_method(name, plugin=toys, limit_s=10 if name == "toy-hangs" else 60)
    (failed,) = report.failed
    assert failed.check == check
    assert failed.message.startswith(says)
    assert line in failed.trace
    passed = len(report.results) - 1
    assert len(report.having("passed")) == passed
    left = len(EVERYTHING) - passed - 1
    assert report.summary().endswith(
        f" ran, {passed} passed, 1 failed, {left} not tried for that reason."
    )


def test_a_hole_is_found() -> None:
    report = check_method("contract-hole", plugin=PLUGIN)
    (found,) = (result for result in report.failed if result.check == "finite")
    assert found.message == "3 of 4800 pixels are NaN or infinite."


@pytest.mark.slow
def test_a_method_that_will_not_stop_is_stopped_at_the_limit() -> None:
    subject_model = SCENARIO.nominal_sensor
    forward_model(subject_model).jacobian(np.ones(subject_model.image_shape))  # compiles it
    report = check_method("contract-slow", plugin=PLUGIN, limit_s=8)
    (found,) = report.failed
    assert found.check == "in_time"
    assert found.message == "reconstruct took longer than 8 s."


def test_an_expected_failure_is_none_and_keeps_its_reason() -> None:
    report = check_method("contract-excused", plugin=PLUGIN)
    (found,) = report.having("xfail")
    assert found.check == "rotation_equivariance"
    assert found.message.endswith("0.01 is allowed. Expected: sees more at the top.")
    assert report.passed
    assert report.counts["xfail"] == 1
    assert "0 failed, 1 failed as expected, 2 skipped." in report.summary()


def test_an_expected_failure_that_passes_fails() -> None:
    report = check_method("contract-outdated", plugin=PLUGIN)
    (found,) = report.failed
    assert found.check == "rotation_equivariance"
    assert found.message == (
        "it passes although it is expected to fail (saw more at the top): remove it from "
        "`expected_failures`."
    )


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("contract-no-such-check", "did you mean 'rotation_equivariance'"),
        ("contract-no-reason", "should map names of checks to reasons"),
        ("contract-no-mapping", "should map names of checks to reasons"),
    ],
)
def test_an_expected_failure_needs_a_check_and_a_reason(name: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        check_method(name, plugin=PLUGIN)


def test_a_sensor_that_no_motion_brings_onto_itself_has_none_to_check(tmp_path: Path) -> None:
    subject = MethodUnderTest(SCENARIO, "back-projection", None, 60, tmp_path)
    subject.motions = subject.motions[:1]
    for check in (rotation_equivariance, mirror_equivariance):
        with pytest.raises(SkippedError, match=r"has no (rotation|mirror) symmetry"):
            check(subject)


@pytest.mark.slow
def test_a_method_of_one_image_grid_is_checked_there() -> None:
    report = check_method("contract-own-grid", plugin=PLUGIN)
    assert report.where == "foam16, 80 x 80"
    assert not report.failed
    skipped = {result.check: result.message for result in report.having("skipped")}
    assert skipped == {
        "conductive_contact": "the conductivity range of this sensor allows it to fall only.",
        "uncertainty": "it states no uncertainty.",
        "novelty": "it states no novelty.",
    }


def test_an_unknown_method_suggests_the_nearest() -> None:
    with pytest.raises(InputError, match="Unknown method or operator 'nosr': did you mean 'noser'"):
        check_target("nosr")
