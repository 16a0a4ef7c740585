from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.support.figures import assert_no_text_overlaps_or_is_cut

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.figures import image_grid
from eitbench.reports.figures.image_grid import _tile, comparison, draw, write_figures
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.similarity import Similarity


@pytest.mark.slow
def test_every_scenario_is_drawn_as_png_and_pdf(
    full_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(image_grid, "draw", lambda grid: Figure(figsize=(1, 1)))
    written = write_figures(full_run)
    assert len(written) == 8
    assert all(path.parent == full_run / "figures" for path in written)
    for path in written:
        start = path.read_bytes()[:4]
        assert start == (b"\x89PNG" if path.suffix == ".png" else b"%PDF")


@pytest.mark.slow
@pytest.mark.parametrize(
    "scenario", ["conductivity-set", "position-set", "classes-set", "none-set"]
)
def test_no_text_overlaps_with_few_methods(full_run: Path, scenario: str) -> None:
    assert_no_text_overlaps_or_is_cut(draw(comparison(read_run(full_run), scenario)))


@pytest.mark.slow
def test_no_text_overlaps_with_many_methods_and_long_names(build: Any, dataset_of: Any) -> None:
    names = [f"a-method-with-quite-a-long-name-number-{k}-and-more-of-it" for k in range(9)]
    shares = {name: 0.9 - k / 50 for k, name in enumerate(names)}
    lost = {name: k % 3 for k, name in enumerate(names)}
    build.add_scaled(dataset_of("conductivity", 4), shares, lost=lost)
    grid = comparison(read_run(build.write()), "conductivity-set")
    assert len(grid.columns) == 10
    assert_no_text_overlaps_or_is_cut(draw(grid))


def test_truth_first_then_methods_by_rank_one_row_per_family(full_run: Path) -> None:
    grid = comparison(read_run(full_run), "conductivity-set")
    assert grid.columns == ("truth", "sharp", "blurred", "constant")
    assert [label[0] for label, _ in grid.rows] == ["circle", "two-circles", "ring"]
    truth, _, blurred, _ = grid.rows[0][1]
    assert truth.image is not None
    assert truth.image.min() == pytest.approx(0.3)
    assert grid.limits[0] < 0.3 < 1.0 < grid.limits[1]
    assert blurred.note[0].startswith("SSIM 0.")
    assert "PSNR" in blurred.note[1]


def test_presses_are_marked_in_the_image_s_frame(full_run: Path) -> None:
    grid = comparison(read_run(full_run), "position-set")
    assert grid.title == "bench / position-set: sensor disc, 8 test samples"
    assert "truth" not in grid.columns
    assert grid.contrast
    x0, y0, x1, y1 = grid.bounds
    for _, tiles in grid.rows:
        sharp = tiles[grid.columns.index("sharp")]
        assert sharp.image is not None
        (cross,) = sharp.crosses
        row, column = np.unravel_index(np.nanargmin(sharp.image), sharp.image.shape)
        found = x0 + (column + 0.5) / 40 * (x1 - x0), y0 + (row + 0.5) / 40 * (y1 - y0)
        assert np.hypot(*np.subtract(found, cross)) < 0.02
        assert np.isnan(sharp.image[0, 0])


def test_every_contact_has_its_cross(full_run: Path) -> None:
    places = np.array([[0.03, 0.05], [0.08, 0.02]])
    registration = Similarity(2.0, np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([0.01, 0.02]))
    row = {
        "status": "ok", "expected_x_m": 0.0, "expected_y_m": 0.0, "found_x_m": 0.0,
        "x_m": places[0, 0], "y_m": places[0, 1], "x2_m": places[1, 0], "y2_m": places[1, 1],
        "x3_m": np.nan, "y3_m": np.nan,
    }  # fmt: skip
    scene = read_run(full_run).scene("position-set", [0])
    image = np.zeros(scene.mask.shape)
    tile = _tile({0: row}, 0, image, scene, registration)
    np.testing.assert_allclose(registration(tile.crosses), places)
    assert len(_tile({0: row | {"x2_m": np.nan}}, 0, image, scene, registration).crosses) == 1


def test_a_lost_frame_says_why(build: Any, dataset_of: Any) -> None:
    build.add_scaled(dataset_of("conductivity", 3), {"some": 1.0}, lost={"some": 1})
    grid = comparison(read_run(build.write()), "conductivity-set")
    notes = [tiles[1].note for _, tiles in grid.rows if tiles[1].image is None]
    assert notes == [("timeout",)]
    assert_no_text_overlaps_or_is_cut(draw(grid))


@pytest.mark.parametrize("truth", ["conductivity", "position"])
def test_methods_without_any_image_are_named_below(build: Any, dataset_of: Any, truth: str) -> None:
    build.add_scaled(dataset_of(truth, 3), {"lost": 1.0, "kept": 1.0}, lost={"lost": 3})
    grid = comparison(read_run(build.write()), f"{truth}-set")
    assert "kept" in grid.columns
    assert "lost" not in grid.columns
    assert grid.footnote.splitlines()[-1].endswith("lost (timeout)")
    assert_no_text_overlaps_or_is_cut(draw(grid))


def test_names_cannot_leave_the_folder_or_be_formulas(build: Any, dataset_of: Any) -> None:
    build.add_scaled(dataset_of("conductivity", 3), {"$x_{y$\x1b": 1.0})
    path = build.write()
    assert [p.name for p in write_figures(path)] == [
        "comparison-conductivity-set.png",
        "comparison-conductivity-set.pdf",
    ]
    grid = comparison(read_run(path), "conductivity-set")
    assert grid.columns == ("truth", "$x_{y$\\x1b")


def test_figures_that_cannot_be_written_are_one_sentence(build: Any, dataset_of: Any) -> None:
    build.add_scaled(dataset_of("conductivity", 3), {"some": 1.0})
    path = build.write()
    (path / "figures").write_text("in the way")
    with pytest.raises(EitbenchError, match="figures"):
        write_figures(path)
