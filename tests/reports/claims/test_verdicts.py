"""The rules of the verdicts, for any numbers."""

from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitbench.benchmark.metrics.statistics import Interval
from eitbench.reports.claims.claim import (
    Tolerance,
    Verdict,
    agrees,
    reaches,
    surely_better,
    together,
)

Best = Literal["max", "min"]
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
