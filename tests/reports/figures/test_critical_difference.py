"""The critical-difference figure: which methods its bars join, and that nothing of it is cut."""

import matplotlib as mpl
import pytest

from eitbench.reports.figures.critical_difference import critical_difference_figure, joined
from eitbench.reports.figures.style import STYLE


@pytest.mark.parametrize(
    ("ranks", "bars"),
    [
        ([1.0, 2.0, 3.5], []),
        ([1.0, 1.5, 3.5], [(0, 1)]),
        ([1.0, 1.8, 2.6, 3.4], [(0, 1), (1, 2), (2, 3)]),
        ([1.0, 1.2, 1.4, 3.0], [(0, 2)]),  # what lies within another bar has none
        ([2.0, 2.0], [(0, 1)]),
    ],
)
def test_bars_join_what_differs_by_less(ranks: list[float], bars: list[tuple[int, int]]) -> None:
    assert joined(ranks, 1.0) == bars


@pytest.mark.parametrize(("count", "difference"), [(2, 0.8), (2, 30.0), (15, 4.0)])
def test_nothing_is_cut(count: int, difference: float) -> None:
    ranks = [(f"gauss-newton-of-{'many ' * k}$letters", 1.0 + k) for k in range(count)]
    with mpl.rc_context(STYLE):
        figure = critical_difference_figure(ranks, difference)
        figure.draw_without_rendering()
    (axes,) = figure.axes
    assert len(axes.texts) > count
    for artist in (*axes.texts, *axes.lines):
        box = artist.get_window_extent()
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0
        assert box.y1 <= figure.bbox.y1
