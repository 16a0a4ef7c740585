"""The table and the figure of the error over labelled presses."""

import numpy as np
import pytest

from eitbench.benchmark.analysis.transfer import SkinError, over_skins
from eitbench.reports.figures.transfer import draw, grid


def errors(method: str, labelled: int, medians: list[float]) -> list[SkinError]:
    return [
        SkinError(f"skin-{k}", labelled, method, median, 2 * median, 500)
        for k, median in enumerate(medians)
    ]


MANY = [
    *errors("ridge", 0, [9.0, 20.0, 14.0]),
    *errors("ridge", 100, [3.0, 5.0, 40.0]),
    *errors("network", 100, [4.0, 2.0]),
]


def test_skins_count_alike() -> None:
    curves = over_skins(MANY)
    assert list(curves["median_mm"]) == [14.0, 3.0, 5.0]  # by number of presses, then by error
    assert list(curves["skins"]) == [3, 2, 3]
    low, high, p90 = curves[["low_mm", "high_mm", "p90_mm"]].to_numpy(np.float64).T
    assert 3.0 <= low[2] < 5.0 < high[2] <= 40.0
    assert np.isnan(low[1])  # of two skins nothing is known
    assert p90[2] == 10.0


def test_the_table_has_what_was_run() -> None:
    heads, *rows = grid(over_skins(MANY))
    assert heads == ["method", "0 labelled [mm]", "100 labelled [mm]"]
    assert [row[0] for row in rows] == ["ridge", "network"]
    assert rows[1][1:] == ["–", "3.0"]


def test_no_labelled_presses_have_a_place_on_the_axis() -> None:
    (axes,) = draw(over_skins(MANY)).axes
    assert axes.get_xscale() == "log"
    assert [label.get_text() for label in axes.get_xticklabels()] == ["0", "100"]
    assert 0 < axes.get_xticks()[0] < 100


@pytest.mark.parametrize("counts", [[0], [0, 10], [10, 400]])
def test_few_counts_are_drawn(counts: list[int]) -> None:
    some = [error for count in counts for error in errors("ridge", count, [1.0, 2.0])]
    assert draw(over_skins(some)).axes
