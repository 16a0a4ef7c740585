"""Runs as evidence: what counts, and what says why it does not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.reports.claims.conftest import N, findings
from tests.support.made_runs import made

from eitbench.benchmark import InputError
from eitbench.reports.claims.claim import (
    Verdict,
)
from eitbench.scenarios.data.datasets import Dataset


@pytest.mark.parametrize("n", [2, 60])
def test_few_samples_decide_nothing(n: int, build: Any) -> None:
    few = made("conductivity", n, scenario="paper", inverse_crime=True)
    build.suite = "paper"
    build.add(few, "phydnn", np.array(few.conductivity))
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.undecided
    assert f"{n} samples are too few" in found.why


def test_one_sample_measures_nothing(build: Any) -> None:
    one = made("conductivity", 1, scenario="paper", inverse_crime=True)
    build.suite = "paper"
    build.add(one, "phydnn", np.array(one.conductivity))
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.untestable
    assert found.why.startswith("One sample has no interval")


def test_a_limited_run_says_so(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    build.limit = N
    assert findings(build.write())["table2-phydnn"].conditions.startswith(f"the first {N} test")


@pytest.mark.slow
def test_pairs_are_of_the_same_frames_whatever_the_order_and_the_run(
    add: Callable[..., None], build: Any
) -> None:
    add("phydnn", 0.02)
    one = build.write()
    build.path, build.samples, build.methods, build.images = one.parent / "other", [], [], {}
    add("dnn", 0.04)
    build.samples[0] = build.samples[0].iloc[::-1]
    assert findings(one, build.write())["phydnn-over-dnn"].verdict is Verdict.holds
    build.samples[0] = build.samples[0].assign(input_hash="another")
    other = findings(one, build.write())["phydnn-over-dnn"]
    assert other.verdict is Verdict.untestable
    assert other.why == "'phydnn' and 'dnn' were not run on the same frames."


def test_a_failed_method_is_not_testable_and_its_own_sentence_says_why(
    build: Any, paper: Dataset
) -> None:
    build.suite = "paper"
    build.add(paper, "phydnn", np.array(paper.conductivity), lost=1)
    build.samples[0]["message"] = "InputError: 'phydnn' has no weights: train them"
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.untestable
    assert "1 sample failed" in found.why
    assert found.why.endswith("InputError: 'phydnn' has no weights: train them.")


def test_a_method_that_was_left_out_is_not_testable_and_the_run_says_why(
    add: Callable[..., None], build: Any
) -> None:
    add("dnn", 0.01)
    why = "Scenario 'paper' is left out for 'phydnn': it has no weights."
    build.skipped = {"paper/phydnn": why}
    found = findings(build.write())
    for name in ("table2-phydnn", "phydnn-over-dnn", "frame-rate"):
        assert (found[name].verdict, found[name].why) == (Verdict.untestable, why)


def test_an_unfinished_run_is_no_evidence(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    build.samples[0] = build.samples[0].iloc[:5]
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.untestable
    assert f"holds 5 of {N} samples of 'phydnn'" in found.why


def test_another_suite_s_scenario_of_that_name_is_no_evidence(
    add: Callable[..., None], build: Any, build_operators: Callable[..., Path]
) -> None:
    add("phydnn", 0.01)
    build.samples[0]["suite"] = "mine"
    operators = build_operators({"surrogate": 1e-3, "jacobian": 1e-2}, suite="mine")
    for found in findings(build.write(), operators).values():
        assert (found.verdict, found.n) == (Verdict.untestable, None)


def test_two_runs_of_one_method_are_refused(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    one = build.write()
    build.path = one.parent / "other"
    with pytest.raises(InputError, match=r"run and .*other both hold the method 'phydnn'"):
        findings(one, build.write())


def test_other_scenarios_are_compared_where_their_suite_is_the_packaged_one(
    build: Any, many: Dataset
) -> None:
    build.suite = "shapes"
    shapes = replace(many, scenario="shapes")
    shapes.__dict__["conductivity"] = truth = np.array(many.conductivity)
    build.add(shapes, "phydnn", truth)
    build.add(shapes, "dnn", truth + 0.1)
    found = findings(build.write())
    assert found["generalisation"].verdict is Verdict.undecided  # CC is the same
    assert "'shapes'" in found["generalisation"].conditions
    assert found["phydnn-over-dnn"].verdict is Verdict.untestable
