"""Verdicts on the published claims: their rules, and runs that were made to deserve them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.reports.claims.claim import (
    Best,
    Finding,
    Tolerance,
    Verdict,
    agrees,
    reaches,
    surely_better,
    together,
)
from eitbench.reports.claims.classical_rows import classical_readings
from eitbench.reports.claims.evidence import Evidence
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.reports.claims.rules import IMAGE_METRICS
from eitbench.reports.studies.summaries import StudySummary
from eitbench.reports.tables.published import TABLE_II
from eitbench.scenarios.data.datasets import Dataset

NAMES = [claim.name for claim in CLAIMS]


def findings(*runs: Path) -> dict[str, Finding]:
    evidence = Evidence([read_run(run) for run in runs])
    return {claim.name: claim.finding(evidence) for claim in CLAIMS}


@pytest.fixture
def add(build: Any, paper: Dataset) -> Callable[..., None]:
    """Add a method with so much noise on the truth, and these times."""
    build.suite = "paper"

    def adding(method: str, noise: float, p99_ms: float | None = 20.0, seed: int = 0) -> None:
        truth = np.array(paper.conductivity)
        rng = np.random.default_rng(seed)
        build.add(paper, method, truth + noise * rng.standard_normal(truth.shape))
        build.methods[-1]["frame_ms_p99"] = p99_ms

    return adding


def study(name: str, rows: list[dict[str, Any]]) -> StudySummary:
    return StudySummary(
        study=name, suite="paper", epochs=12, limit=4000, scored=500, operator="fem",
        training_hours=1.5, rows=rows,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("best", "lead", "verdict"),
    [(0.003, 0.2, Verdict.in_part), (0.003, 0.001, Verdict.holds), (0.3, 0.001, Verdict.in_part),
     (0.3, 0.2, Verdict.fails)],
)  # fmt: skip
def test_the_best_beta(best: float, lead: float, verdict: Verdict) -> None:
    """Scores of neighbours differ by 0.01; the best leads the rest by `lead`."""
    betas = [1e-4, 1e-3, 0.0029, 0.003, 0.03, 0.3]
    rows = [
        {"beta": beta, "score": 7 + 0.01 * (k % 2) + (lead if beta == best else 0), "n": 500}
        for k, beta in enumerate(betas)
    ]
    rows[2]["score"] = 7.01  # at the published beta
    rows[betas.index(best)]["score"] = 7.01 + lead
    lost = {"beta": 0.5}  # a training that diverged
    evidence = Evidence([], {"beta": study("beta", [*rows, lost])})
    claim = CLAIMS[NAMES.index("best-beta")]
    found = claim.finding(evidence)
    assert (found.verdict, found.figures[0].ours) == (verdict, best)
    assert "4,000 samples of 'paper' for 12 epochs" in found.conditions


@pytest.mark.parametrize(
    ("sides", "verdict"),
    [((1, 1, 1, 1), Verdict.holds), ((1, 0, 0, 0), Verdict.in_part),
     ((-1, 0, -1, 0), Verdict.fails)],
)  # fmt: skip
def test_phydnn_over_dnn_with_seeds(sides: tuple[int, ...], verdict: Verdict) -> None:
    """+1: surely better, 0: the interval holds 0, -1: surely worse; RIE is better when smaller."""
    rows = []
    for metric, side in zip(IMAGE_METRICS, sides, strict=True):
        middle = 0.1 * side * (-1 if metric == "rie" else 1)
        for scenario, physics, value in (
            ("paper", "surrogate", middle),
            ("paper", "fem", -middle),
            ("shapes", "surrogate", -middle),
        ):
            rows.append(
                {"scenario": scenario, "physics": physics, "metric": metric, "difference": value,
                 "low": value - 0.05, "high": value + 0.05, "each_seed": [value] * 3, "n": 500}
            )  # fmt: skip
    evidence = Evidence([], {"physics": study("physics", rows)})
    found = CLAIMS[NAMES.index("phydnn-over-dnn-seeds")].finding(evidence)
    assert (found.verdict, found.n) == (verdict, 500)
    assert "3 trainings" in found.why


def test_every_claim_says_what_it_is() -> None:
    assert len(set(NAMES)) == len(NAMES)
    for claim in CLAIMS:
        assert claim.says.endswith(".")
        assert claim.published
        assert claim.tolerance
        assert claim.command.startswith("eitbench ")


def test_without_runs_nothing_is_testable_and_the_published_figures_stand() -> None:
    for claim in CLAIMS:
        found = claim.finding(Evidence([]))
        assert found.verdict is Verdict.untestable
        assert found.figures == claim.published
        assert all(figure.ours is None and figure.met is None for figure in found.figures)
        assert found.why.endswith(".")
    assert "'phydnn'" in findings()["table2-phydnn"].why


@pytest.mark.parametrize(
    ("noise", "verdict", "kept"),
    [
        (0.001, Verdict.holds, [True, True, True, True]),
        (0.024, Verdict.in_part, [False, False, True, True]),
        (0.3, Verdict.fails, [False, False, False, False]),
    ],
)
def test_the_row_of_phydnn(
    noise: float, verdict: Verdict, kept: list[bool], add: Callable[..., None], build: Any
) -> None:
    add("phydnn", noise)
    found = findings(build.write())["table2-phydnn"]
    figures = dict(zip(IMAGE_METRICS, found.figures, strict=True))
    assert {n: f.published for n, f in figures.items()} == TABLE_II["phydnn"]
    assert figures["psnr"].ours == pytest.approx(-20 * np.log10(noise), abs=0.2)
    assert (found.verdict, found.n) == (verdict, 8)
    assert [figure.met for figure in found.figures] == kept
    assert found.conditions.startswith("all 8 test samples of 'paper', from the mesh")


def test_a_limited_run_says_so(add: Callable[..., None], build: Any) -> None:
    add("phydnn", 0.01)
    build.limit = 8
    assert findings(build.write())["table2-phydnn"].conditions.startswith("the first 8 test")


def test_a_classical_row_is_not_kept_by_being_better(add: Callable[..., None], build: Any) -> None:
    add("noser", 0.1)
    found = findings(build.write())["table2-noser"]
    assert found.verdict is Verdict.fails
    assert [figure.published for figure in found.figures] == ["near or below 0", 1.21, -1.08]
    assert "under Two readings" in found.why


def test_a_classical_row_holds_where_figures_are_as_published(build: Any, paper: Dataset) -> None:
    """-0.22 everywhere: an error of about 1.2 on a background of 1."""
    build.suite = "paper"
    build.add(paper, "noser", np.full_like(np.array(paper.conductivity), -0.22))
    found = findings(build.write())["table2-noser"]
    assert found.verdict is Verdict.holds
    assert [figure.met for figure in found.figures] == [True, True, True]


@pytest.mark.parametrize(
    ("phydnn", "dnn", "verdict"),
    [(0.02, 0.04, Verdict.holds), (0.04, 0.02, Verdict.fails), (0.02, 0.02, Verdict.fails)],
)
def test_phydnn_against_dnn(
    phydnn: float, dnn: float, verdict: Verdict, add: Callable[..., None], build: Any
) -> None:
    add("phydnn", phydnn)
    add("dnn", dnn)
    found = findings(build.write())["phydnn-over-dnn"]
    assert found.verdict is verdict
    assert found.n == 8
    psnr = found.figures[3]
    assert psnr.interval is not None
    assert psnr.ours is not None
    assert psnr.ours == pytest.approx(20 * np.log10(dnn / phydnn), abs=0.05)
    assert psnr.interval[0] <= psnr.ours <= psnr.interval[1]
    assert "One training of each" in found.why


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


@pytest.mark.parametrize(
    ("p99", "verdict"),
    [
        ((20.0, 100.0), Verdict.holds),
        ((20.0, 101.0), Verdict.in_part),
        ((200.0, 101.0), Verdict.fails),
    ],
)
def test_the_frame_rate(
    p99: tuple[float, float], verdict: Verdict, add: Callable[..., None], build: Any
) -> None:
    add("dnn", 0.02, p99[0])
    add("phydnn", 0.02, p99[1])
    found = findings(build.write())["frame-rate"]
    assert found.verdict is verdict
    assert [figure.ours for figure in found.figures] == pytest.approx([1e3 / ms for ms in p99])
    assert f"{p99[0]:.3g} ms (DNN)" in found.why
    assert found.conditions == "one thread of A processor"


def test_a_frame_rate_that_was_not_timed(add: Callable[..., None], build: Any) -> None:
    add("dnn", 0.02, None)
    add("phydnn", 0.02)
    assert findings(build.write())["frame-rate"].verdict is Verdict.untestable


@pytest.mark.parametrize(
    ("ratio", "verdict"),
    [(252.0, Verdict.holds), (5.7, Verdict.holds), (5.6, Verdict.in_part), (0.9, Verdict.fails)],
)
def test_only_the_ratio_of_table_i_is_tested(
    ratio: float, verdict: Verdict, build_operators: Callable[..., Path]
) -> None:
    run = build_operators({"surrogate": 1e-3, "jacobian": ratio * 1e-3})
    found = findings(run)
    assert found["table1-ratio"].verdict is verdict
    (figure,) = found["table1-ratio"].figures
    assert figure.published == 6.3
    assert figure.ours == pytest.approx(ratio)
    row = found["table1-surrogate"]
    assert row.verdict is Verdict.untestable
    assert [figure.published for figure in row.figures] == [2.57e-3, 0.99498]
    assert [figure.ours for figure in row.figures] == pytest.approx([1e-3, 0.999])


def test_a_failed_method_is_not_testable_and_its_own_sentence_says_why(
    build: Any, paper: Dataset
) -> None:
    build.suite = "paper"
    build.add(paper, "phydnn", np.array(paper.conductivity), lost=1)
    build.samples[0]["message"] = "InputError: 'phydnn' has no weights: train them"
    found = findings(build.write())["table2-phydnn"]
    assert found.verdict is Verdict.untestable
    assert "1 samples failed" in found.why
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
    assert "holds 5 of 8 samples of 'phydnn'" in found.why


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


@pytest.fixture
def run(build: Any, paper: Dataset) -> Path:
    """NOSER with half of the contrast, TV that saw nothing."""
    truth = np.array(paper.conductivity)
    build.suite = "paper"
    build.add(paper, "noser", 0.5 * (truth - 1) + 1)
    build.add(paper, "tv", np.ones_like(truth))
    path: Path = build.write()
    return path


def test_readings_are_called_consistent_and_never_proven(run: Path) -> None:
    readings = classical_readings(Evidence([read_run(run)]))
    noser, tv = readings["methods"]
    *names, scaled = (row["reading"] for row in noser["rows"])
    assert names == [
        "published", "absolute map", "difference image", "difference, sign reversed",
    ]  # fmt: skip
    assert "times as strong" in scaled
    assert "is consistent with" in noser["says"]
    assert "does not exclude other explanations" in noser["says"]
    # An image that shows nothing has no strength that would give the published error.
    assert len(tv["rows"]) == 4
    assert "consistent" not in tv["says"]
    assert "absolute maps" in readings["says"]
    assert "prove" not in noser["says"] + tv["says"] + readings["says"]


def test_figures_that_do_not_fit_are_not_called_consistent(build: Any, paper: Dataset) -> None:
    """An image unlike any touch: the RIE can be had by its scale, the SSIM is not near 0."""
    truth = np.array(paper.conductivity)
    build.suite = "paper"
    build.add(paper, "noser", 1 + truth)
    noser, _ = classical_readings(Evidence([read_run(build.write())]))["methods"]
    assert "is not consistent with that either" in noser["says"]


def test_without_a_run_there_is_a_reason_for_no_reading() -> None:
    readings = classical_readings(Evidence([]))
    assert readings["constants"] == []
    for method, name in zip(readings["methods"], ("noser", "tv"), strict=True):
        assert [row["reading"] for row in method["rows"]] == ["published"]
        assert method["says"] == ""
        assert repr(name) in method["conditions"]


NUMBERS = st.floats(-1e3, 1e3)
TOLERANCES = st.builds(Tolerance, st.floats(0, 10), st.floats(0, 1))


@given(NUMBERS, NUMBERS, TOLERANCES)
def test_only_what_agrees_reaches_in_both_directions(
    ours: float, published: float, tolerance: Tolerance
) -> None:
    both = all(reaches(ours, published, tolerance, best) for best in ("max", "min"))
    assert both == agrees(ours, published, tolerance)


@pytest.mark.parametrize(
    ("ours", "published", "tolerance", "best", "kept"),
    [
        (0.966, 0.9754, Tolerance(absolute=0.01), "max", True),
        (0.965, 0.9754, Tolerance(absolute=0.01), "max", False),
        (0.99, 0.9754, Tolerance(absolute=0.01), "max", True),
        (0.0324, 0.0295, Tolerance(relative=0.1), "min", True),
        (0.0325, 0.0295, Tolerance(relative=0.1), "min", False),
        (0.01, 0.0295, Tolerance(relative=0.1), "min", True),
        (-2.0, -1.08, Tolerance(absolute=1.0), "max", True),
        (-2.1, -1.08, Tolerance(absolute=1.0), "max", False),
    ],
)
def test_margins(
    ours: float, published: float, tolerance: Tolerance, best: Best, kept: bool
) -> None:
    assert reaches(ours, published, tolerance, best) is kept


@given(st.lists(st.booleans(), min_size=1))
def test_all_some_or_none(kept: list[bool]) -> None:
    expected = {len(kept): Verdict.holds, 0: Verdict.fails}.get(sum(kept), Verdict.in_part)
    assert together(kept) is expected


@pytest.mark.parametrize(
    ("interval", "up", "down"),
    [
        (Interval(0.2, 0.1, 0.3), True, False),
        (Interval(-0.2, -0.3, -0.1), False, True),
        (Interval(0.2, -0.1, 0.5), False, False),
        (Interval(0.2, 0.0, 0.5), False, False),
        (Interval(0.0, 0.0, 0.0), False, False),
    ],
)
def test_only_a_whole_interval_is_sure(interval: Interval, up: bool, down: bool) -> None:
    assert surely_better(interval, "max") is up
    assert surely_better(interval, "min") is down
