"""The checks of operators find what they claim to find, and nothing else."""

import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest

from eitbench.benchmark.checks import check as checks
from eitbench.benchmark.checks.check import OPERATOR_CHECKS, check_operator
from eitbench.benchmark.checks.harness import (
    BrokenError,
    Check,
    CheckReport,
    CheckResult,
    SkippedError,
    run_checks,
    title,
)
from eitbench.benchmark.checks.operator_checks import jax_arrays, jax_transforms
from eitbench.benchmark.checks.operator_under_test import OperatorUnderTest
from eitbench.methods.registry import OPERATOR_REGISTRY, load_plugin, operator
from eitbench.scenarios.errors import InputError

PLUGIN = Path(__file__).parents[1] / "data" / "broken_operators.py"
BROKEN = {
    "operator-kept": set(),
    "operator-nameless": {"described"},
    "operator-flat": {"shapes"},
    "operator-batch": {"batch_equals_single", "adjoint", "jax_transforms"},
    "operator-random": {"deterministic"},
    "operator-in-place": {"unchanged_input"},
    "operator-numpy": {"torch_tensors", "jax_arrays"},
    "operator-single": {"single_precision"},
    "operator-double": {"precision_kept"},
    "operator-scaled": {"reference_voltages"},
    "operator-slope": {"differences", "adjoint"},
    "operator-bent": {"adjoint"},
    "operator-detached": {"autograd"},
    "operator-one-way": {"reciprocity"},
    "operator-boastful": {"scaling"},
    "operator-lenient": {"refuses_pixels"},
    "operator-cropping": {"refuses_grids"},
    "operator-casting": {"refuses_precisions"},
    "operator-broadcasting": {"refuses_cotangents"},
}


@pytest.fixture(scope="module")
def plugin() -> Iterator[None]:
    """The broken operators, known in this process as long as these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OPERATOR_REGISTRY, "_registered", OPERATOR_REGISTRY.known())
        load_plugin(PLUGIN)
        yield


def results(
    subject: OperatorUnderTest, checks: Sequence[Check] = OPERATOR_CHECKS
) -> dict[str, CheckResult]:
    """In this process; what an operator raises is a finding."""

    def run(check: Check) -> str | None:
        try:
            return check(subject)
        except (BrokenError, SkippedError):
            raise
        except Exception as error:
            raise BrokenError(f"it raises {error}") from error

    return {result.check: result for result in run_checks(checks, run, {})}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_promise_is_found_alone(name: str, plugin: None) -> None:
    found = results(OperatorUnderTest.of(partial(operator, name)))
    assert {check for check, result in found.items() if result.status == "failed"} == BROKEN[name]


def test_every_check_can_fail() -> None:
    assert set().union(*BROKEN.values()) == {check.__name__ for check in OPERATOR_CHECKS}


@pytest.mark.slow
def test_an_operator_that_cannot_be_evaluated_is_told_so_once(tmp_path: Path) -> None:
    plugin = tmp_path / "fails.py"
    plugin.write_text(
        "from eitbench.methods import Operator, register_operator\n"
        "@register_operator('fails')\n"
        "class Fails(Operator):\n"
        "    def tensor_voltages(self, sigma):\n"
        "        raise ArithmeticError('no voltages')\n"
    )
    report = check_operator("fails", plugin=plugin)
    assert [result.check for result in report.results] == ["described", "shapes"]
    assert report.results[1].message == "it raises ArithmeticError: no voltages."
    assert report.untried == len(OPERATOR_CHECKS) - 2


@pytest.mark.parametrize("name", ["fem", "jacobian"])
def test_what_comes_with_eitbench_keeps_the_contract(name: str) -> None:
    subject = OperatorUnderTest.of(partial(operator, name))
    found = results(subject)
    assert [result for result in found.values() if result.status == "failed"] == []
    skipped = {check for check, result in found.items() if result.status == "skipped"}
    assert skipped == (set() if name == "fem" else {"scaling"})
    if name == "jacobian":
        assert "exact = True" in found["scaling"].message
    else:
        assert "(1e-06 is allowed)" in found["differences"].message


def test_without_jax_its_checks_are_skipped_with_a_reason(
    monkeypatch: pytest.MonkeyPatch, plugin: None
) -> None:
    monkeypatch.setattr("eitbench.scenarios.extras.find_spec", lambda name: None)
    subject = OperatorUnderTest.of(partial(operator, "operator-kept"))
    for result in results(subject, [jax_arrays, jax_transforms]).values():
        assert result.status == "skipped"
        assert "pip install" in result.message


@pytest.mark.slow
def test_a_report_counts_what_ran_and_what_was_skipped() -> None:
    """In a worker, for an operator that exists for one image grid only."""
    report = check_operator("operator-large-only", plugin=PLUGIN)
    assert report.passed
    assert report.summary() == (
        "operator-large-only on foam16, 80 x 80: 19 checks ran, 19 passed, 0 failed, 1 skipped."
    )
    described = report.describe()
    assert described["operator"] == "operator-large-only"
    assert (described["ran"], described["skipped"]) == (19, 1)


@pytest.mark.slow
def test_an_operator_that_cannot_be_made_is_told_so_once() -> None:
    report = check_operator("toy-set-up", plugin=PLUGIN.with_name("toy_operators.py"))
    (found,) = report.results
    assert found.name == title(OPERATOR_CHECKS[0])
    assert found.message == "set-up failed with RuntimeError: no weights for this sensor."
    assert 'toy_operators.py", line' in found.trace
    assert report.untried == len(OPERATOR_CHECKS) - 1


@pytest.mark.slow
def test_a_file_may_hold_methods_and_operators(monkeypatch: pytest.MonkeyPatch) -> None:
    def named(kind: str, name: str, plugin: Path) -> CheckReport:
        assert plugin == file
        return CheckReport(kind, name, "nowhere", ())

    monkeypatch.setattr(checks, "check_method", partial(named, "method"))
    monkeypatch.setattr(checks, "check_operator", partial(named, "operator"))
    file = PLUGIN.with_name("toy_operators.py")
    found = {report.name: report.kind for report in checks.check_target(str(file))}
    assert found.pop("toy-method") == "method"
    assert set(found.values()) == {"operator"}
    names = re.findall(r'"(toy-[a-z-]+)"', file.read_text())
    assert {*found, "toy-method"} == {*names}


def test_an_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(
        InputError, match="Unknown method or operator 'jacobina': did you mean 'jac"
    ):
        checks.check_target("jacobina")
    with pytest.raises(InputError, match="Unknown operator 'fme': did you mean 'fem'"):
        check_operator("fme")
