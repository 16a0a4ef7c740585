"""Maps of the error of the place over a sensor."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.place_errors import LEAST_PRESSES
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, PLACE_RUNS
from eitbench.reports.figures.error_maps import error_maps_figure
from eitbench.reports.page.error_maps import error_maps
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.similarity import Similarity
from eitbench.scenarios.suites.suite import load_suite

PLACES = 1e-3 * np.random.default_rng(0).uniform(-40, 40, size=(1200, 2))
TURNED = Similarity(0.5, np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([0.01, -0.02]))
"""From the image onto the robot: turned over, so that a map in the image's frame would show it."""


def cell(error: np.ndarray) -> pd.DataFrame:
    expected = TURNED.inverse(PLACES[: len(error)])
    columns = {"sample": np.arange(len(error)), "localisation_mm": error}
    table = pd.DataFrame(columns | {f"expected_{a}_m": expected[:, k] for k, a in enumerate("xy")})
    return table.sample(frac=1, random_state=0)  # in any order


def run_of(*names: str) -> Run:
    manifest = {"plan": {"suite": load_suite("skins").model_dump(mode="json")}}
    cells = [
        {"scenario": "cam09-05", "method": name, "registration": TURNED.to_json()} for name in names
    ]
    return Run(Path("run"), METHOD_RUNS, manifest, pd.DataFrame(), pd.DataFrame(cells), {})


def test_methods_of_places_have_the_coordinates_of_the_robot() -> None:
    """With labelled presses nothing is registered; without, what is found is, the truth is not."""
    errors = np.where(PLACES[:, 0] > 0, 20.0, 2.0)
    table = cell(errors).sort_values("sample")
    table[["expected_x_m", "expected_y_m"]] = PLACES
    image = error_maps({"m": (run_of("m"), "m")}, {"m": cell(errors)}, "cam09-05")
    for registration in ("", TURNED.to_json()):
        run = replace(run_of("m"), kind=PLACE_RUNS)
        run.cells["registration"] = registration
        assert error_maps({"m": (run, "m")}, {"m": table}, "cam09-05") == image


def test_errors_stand_where_the_robot_pressed() -> None:
    blind = PLACES[:, 0] > 0
    cells = {"half-blind": cell(np.where(blind, 20.0, 2.0)), "poor": cell(np.full(1200, 9.0))}
    run = run_of(*cells)
    found = error_maps({name: (run, name) for name in cells}, cells, "cam09-05")
    assert found is not None
    x0, y0, side = found["edges"]
    first, second = (np.array(of["error"], dtype=float) for of in found["maps"])
    x = x0 + side * (np.arange(first.shape[1]) + 0.5)
    assert (first[:, x > side / 2] == 20).all()
    assert (first[:, x < -side / 2] == 2).all()
    assert np.nanmin(second) == np.nanmax(second) == 9
    assert found["maps"][1] == {"method": "poor", "median": 9.0, "error": second.tolist()}
    assert y0 + side * len(first) == pytest.approx(-y0, abs=1)
    rim = 1e3 * recorded_set("cam09-05").sensor().outline.perimeter / (2 * np.pi)
    np.testing.assert_allclose(np.hypot(*np.transpose(found["electrodes"])), rim, atol=0.01)
    figure = error_maps_figure([("skin", found, of) for of in found["maps"]], 3.5, 2)
    median = found["maps"][0]["median"]
    titles = [axes.get_title() for axes in figure.axes[:2]]
    assert titles == [f"skin\nhalf-blind: {median:.1f} mm", "skin\npoor: 9.0 mm"]


def test_few_presses_or_no_places_have_no_map() -> None:
    few = {"a": cell(np.ones(LEAST_PRESSES - 1))}
    assert error_maps({"a": (run_of("a"), "a")}, few, "cam09-05") is None
    none = {"a": cell(np.ones(200)).assign(expected_x_m=np.nan)}
    assert error_maps({"a": (run_of("a"), "a")}, none, "cam09-05") is None


@pytest.mark.parametrize("width", [0.0, 1e-10])
def test_places_on_a_line_are_no_map(width: float) -> None:
    table = cell(np.full(1200, 9.0)).sort_values("sample")
    table["expected_y_m"] = 0.01 + width * np.arange(1200) / 1200
    assert error_maps({"m": (run_of("m"), "m")}, {"m": table}, "cam09-05") is None
