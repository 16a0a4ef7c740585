"""The table and the maps of acuity show the figures they are given."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.findings.acuity import AcuityResult
from eitbench.benchmark.findings.acuity_specs import ACUITY_SPECS
from eitbench.reports.figures.style import svg
from eitbench.reports.findings.acuity import draw, draw_depths, grid, place_grid, places_table


def _result(level: float, smallest: float) -> AcuityResult:
    places = pd.DataFrame({"x_mm": [0.0, 20, 0, 20], "y_mm": [0.0, 0, 20, 20], "depth_mm": 10.0})
    places["smallest_pa"] = [1e3, 2e3, np.nan, 4e3]
    for name in (
        "error_mm", "gain", "amplitude", "position_error_mm", "resolution", "shape_deformation",
        "ringing", "bias_x_mm", "bias_y_mm",
    ):  # fmt: skip
        places[name] = 0.5
    places["room_mm"], places["least_mm"] = [30, 30, np.nan, np.nan], np.nan
    figures = dict.fromkeys([*ACUITY_SPECS, "pull_low", "pull_high"], np.nan)
    figures |= {"auc": 0.875, "smallest_pa": 1e3 * smallest, "noise_figure": 0.7}
    rim = np.array([[-0.01, -0.01], [0.03, -0.01], [0.03, 0.03], [-0.01, 0.03]])
    roc = np.array([[0, 0, 1.0], [0, 1, 1.0]])
    return AcuityResult("acuity", "noser", level, rim, places, roc, figures)


def test_least_noise_comes_first_and_what_is_unknown_is_a_dash() -> None:
    results = [_result(40, np.nan), _result(60, 1.5)]
    heads, first, second = grid(results, "acuity")
    assert [first[0], second[0]] == ["60", "40"]
    at = heads.index("smallest touch [Pa]")
    assert [first[at], second[at]] == ["1,500", "–"]
    assert first[heads.index("pull to the centre")] == "–"
    heads, first, _ = grid(results, "greit")
    assert first[heads.index("noise figure")] == "0.70"
    rows = place_grid(places_table(results))
    assert rows[1] == ["60", "smallest touch [kPa]", "1", "2", "4", "1"]
    assert rows[3] == ["60", "two points [mm]", "–", "–", "–", "4"]


def test_a_cross_is_where_pairs_were_tried_and_a_scale_is_logarithmic() -> None:
    figure = draw([_result(40, np.nan), _result(60, 1.5)])
    panels = [axes for of in figure.subfigs for axes in of.axes if axes.get_title()]
    two_points = next(axes for axes in panels if axes.get_title() == "two points [mm]")
    (crosses,) = (line for line in two_points.lines if line.get_marker() == "x")
    assert np.asarray(crosses.get_xydata()).tolist() == [[0, 0], [20, 0]]  # the others have no room
    (smallest,) = next(a for a in panels if a.get_title() == "smallest touch [kPa]").collections
    assert smallest.norm(np.array([2.0])) == pytest.approx(0.5)  # between 1 and 4 kPa


def test_points_of_a_straight_side_do_not_make_a_picture_larger() -> None:
    few = _result(60, 1.5)
    along = np.linspace(0, 1, 200, endpoint=False)[:, None]
    sides = zip(few.outline, np.roll(few.outline, -1, axis=0), strict=True)
    many = replace(few, outline=np.concatenate([a + along * (b - a) for a, b in sides]))
    assert len(svg(draw([many]))) < 1.1 * len(svg(draw([few])))


def test_depths_have_a_line_for_each_method() -> None:
    figure = draw_depths([_result(40, np.nan), _result(60, 1.5)])
    assert len(figure.axes) == 2 * 5
    (line, right) = figure.axes[0].lines
    assert np.asarray(line.get_xydata()).tolist() == [[10.0, 0.5]]
    assert (np.asarray(right.get_ydata()) == 1).all()
