"""Ranges, margins and verdicts on single figures, and on claims of several."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitbench.benchmark.metrics.metric_spec import Best
from eitbench.benchmark.metrics.statistics import Interval
from eitbench.reports.claims.claim import (
    LEAST_SAMPLES,
    Range,
    Verdict,
    around,
    better,
    together,
    towards,
)

ENDS = st.floats(-1e3, 1e3)


@given(ENDS, ENDS, ENDS, ENDS)
def test_an_interval_holds_or_misses_only_as_a_whole(
    a: float, b: float, c: float, d: float
) -> None:
    low, high = sorted((a, b))
    inside = Range(*sorted((c, d)))
    interval = Interval((low + high) / 2, low, high)
    points = [inside.low <= value <= inside.high for value in np.linspace(low, high, 7)]
    verdict = inside.test(interval, LEAST_SAMPLES)
    if verdict is Verdict.holds:
        assert all(points)
    elif verdict is Verdict.fails:
        assert not any(points)
    assert inside.test(interval, LEAST_SAMPLES - 1) is Verdict.undecided


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [(0.1, 0.3, "holds"), (-0.3, -0.1, "does not hold"), (-0.1, 0.5, "undecided"),
     (0.0, 0.5, "undecided")],
)  # fmt: skip
def test_an_interval_that_holds_0_refutes_nothing(low: float, high: float, verdict: str) -> None:
    interval = Interval((low + high) / 2, low, high)
    assert better("max").test(interval, LEAST_SAMPLES) == verdict
    opposite = {"holds": "does not hold", "does not hold": "holds"}.get(verdict, verdict)
    assert better("min").test(interval, LEAST_SAMPLES) == opposite


@pytest.mark.parametrize(
    ("ours", "best", "verdict", "on_both_sides"),
    [(0.966, "max", "holds", "holds"), (0.965, "max", "does not hold", "does not hold"),
     (0.99, "max", "holds", "does not hold"), (0.985, "min", "holds", "holds"),
     (0.986, "min", "does not hold", "does not hold"), (0.9, "min", "holds", "does not hold")],
)  # fmt: skip
def test_margins(ours: float, best: Best, verdict: str, on_both_sides: str) -> None:
    allowed, exact = around(0.9754, absolute=0.01), Interval(ours, ours, ours)
    assert towards(best, allowed).test(exact, LEAST_SAMPLES) == verdict
    assert allowed.test(exact, LEAST_SAMPLES) == on_both_sides


KINDS = {"h": Verdict.holds, "f": Verdict.fails, "u": Verdict.undecided, "p": Verdict.in_part}


@pytest.mark.parametrize(
    ("figures", "claim"),
    [("h", "h"), ("f", "f"), ("hf", "p"), ("hfu", "p"), ("hu", "u"), ("fu", "f"), ("hp", "p"),
     ("pf", "p"), ("pu", "p"), ("", "u")],
)  # fmt: skip
def test_figures_of_a_claim_together(figures: str, claim: str) -> None:
    for order in (figures, figures[::-1]):
        assert together([KINDS[one] for one in order]) is KINDS[claim]
