"""The table and the maps of acuity show the figures they are given."""

import numpy as np

from eitbench.benchmark.findings.acuity import AcuityResult
from eitbench.reports.findings.acuity import draw, grid, place_grid, places_table


def _result(level: float, smallest: float) -> AcuityResult:
    place = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.02], [0.02, 0.02]])
    figures = dict.fromkeys(
        ("detected", "auc", "pull", "pull_low", "pull_high", "least_mm", "truth_least_mm",
         "false_pairs", "linearity", "unevenness", "smallest_s_mm2", "error_mm"), np.nan,
    )  # fmt: skip
    figures |= {"auc": 0.875, "smallest_pa": 1e3 * smallest}
    ones = np.ones(4)
    return AcuityResult(
        "acuity", "noser", level, place, np.array([1e3, 2e3, np.nan, 4e3]), ones, ones,
        np.full((4, 2), 0.5), np.full(4, np.nan), ones, np.array([[0, 0, 1.0], [0, 1, 1.0]]),
        figures,
    )  # fmt: skip


def test_least_noise_comes_first_and_what_is_unknown_is_a_dash() -> None:
    results = [_result(40, np.nan), _result(60, 1.5)]
    heads, first, second = grid(results)
    assert [first[0], second[0]] == ["60", "40"]
    at = heads.index("smallest touch [kPa]")
    assert [first[at], second[at]] == ["1.5", "–"]
    assert first[heads.index("pull to the centre (95 %)")] == "–"
    rows = place_grid(places_table(results))
    assert rows[1] == ["60", "smallest touch [Pa]", "1000", "2000", "4000", "1"]
    assert len(draw(results).axes) == 2 * 5 + 4  # panels and the scales of four maps
