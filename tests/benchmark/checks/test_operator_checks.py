"""The checks of operators find what they claim to find, and nothing else."""

import importlib.util
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from eitbench.benchmark.checks import targets as checks
from eitbench.benchmark.checks.checking import CheckReport
from eitbench.benchmark.checks.operator_checks import CHECKS, check_operator, checked, result
from eitbench.benchmark.checks.operator_under_test import OperatorUnderTest
from eitbench.methods.registry import OPERATOR_REGISTRY, load_plugin, operator
from eitbench.scenarios.errors import InputError

PLUGIN = Path(__file__).parents[1] / "data" / "broken_operators.py"
GRADIENT, ADJOINT = (
    "the gradient equals central differences",
    "the vjp is the adjoint of the Jacobian",
)
TORCH, JAX = "takes and returns torch tensors", "takes and returns JAX arrays"
AUTOGRAD, JAX_GRAD = "torch.autograd goes through", "jax.jit, vmap and grad go through"
KEPT, SINGLE = "keeps float32 and float64", "float32 agrees with float64"
SCALING = "obeys the scaling law"
BROKEN = {
    "operator-kept": set(),
    "operator-nameless": {"has a description and a source"},
    "operator-flat": {"returns (..., M) for images (..., H, W)"},
    "operator-batch": {"a batch equals its single images", ADJOINT, JAX_GRAD},
    "operator-random": {"the same twice"},
    "operator-in-place": {"leaves its input unchanged"},
    "operator-numpy": {TORCH, JAX},
    "operator-single": {SINGLE},
    "operator-double": {KEPT},
    "operator-scaled": {"the background gives the untouched sensor"},
    "operator-slope": {GRADIENT, ADJOINT},
    "operator-bent": {ADJOINT},
    "operator-detached": {AUTOGRAD},
    "operator-one-way": {"obeys reciprocity"},
    "operator-boastful": {SCALING},
    "operator-lenient": {"refuses pixels that are not above 0"},
    "operator-cropping": {"refuses another image grid"},
    "operator-casting": {"refuses float16 and whole numbers"},
    "operator-broadcasting": {"refuses cotangents of another shape"},
}


@pytest.fixture(scope="module")
def plugin() -> Iterator[None]:
    """The broken operators, known in this process as long as these tests run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OPERATOR_REGISTRY, "_registered", OPERATOR_REGISTRY.known())
        load_plugin(PLUGIN)
        yield


def failed(subject: OperatorUnderTest) -> set[str]:
    found = [result(name, subject) for name in CHECKS]
    bad = [check for check in found if check.status == "failed"]
    assert all(check.message.endswith(".") for check in bad)
    assert all(".." not in check.message for check in bad)
    return {check.name for check in bad}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_promise_is_found_alone(name: str, plugin: None) -> None:
    assert failed(checked(partial(operator, name))) == BROKEN[name]


def test_every_check_can_fail() -> None:
    assert set().union(*BROKEN.values()) == set(CHECKS)


@pytest.mark.parametrize("name", ["fem", "jacobian"])
def test_what_comes_with_eitbench_keeps_the_contract(name: str) -> None:
    subject = checked(partial(operator, name))
    results = {title: result(title, subject) for title in CHECKS}
    assert [r for r in results.values() if r.status == "failed"] == []
    skipped = {title for title, found in results.items() if found.status == "skipped"}
    assert skipped == (set() if name == "fem" else {SCALING})
    if name == "jacobian":
        assert "Only exact operators" in results[SCALING].message
    else:
        assert "(1e-06 is allowed)" in results[GRADIENT].message


def test_without_jax_its_checks_are_skipped_with_a_reason(
    monkeypatch: pytest.MonkeyPatch, plugin: None
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    subject = checked(partial(operator, "operator-kept"))
    for title in (JAX, JAX_GRAD):
        found = result(title, subject)
        assert found.status == "skipped"
        assert "pip install" in found.message


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


def test_an_operator_that_cannot_be_made_fails_every_check() -> None:
    report = check_operator("toy-set-up", plugin=PLUGIN.with_name("toy_operators.py"))
    assert [found.name for found in report.failed] == list(CHECKS)
    assert {found.message for found in report.failed} == {
        "set-up failed with RuntimeError: no weights for this sensor."
    }


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
    assert len(found) == 7


def test_an_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(
        InputError, match="Unknown method or operator 'jacobina': did you mean 'jac"
    ):
        checks.check_target("jacobina")
    with pytest.raises(InputError, match="Unknown operator 'fme': did you mean 'fem'"):
        check_operator("fme")
