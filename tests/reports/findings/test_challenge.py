"""The figure of the challenge's targets, from a run whose classes are finer than its images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from tests.support.reports import report_data

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.figures import image_grid
from eitbench.reports.figures.challenge import draw_challenge
from eitbench.reports.figures.image_grid import comparison, write_figures
from eitbench.reports.findings.collect import findings
from eitbench.reports.page.report import to_page
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.scenarios.arrays import nearest_pixels


@pytest.fixture
def run(build: Any, dataset_of: Any) -> Path:
    for level in range(1, 8):
        coarse = dataset_of("classes", 3, scenario=f"ktc2023-level{level}")
        fine = replace(coarse, classes=nearest_pixels(coarse.classes, (256, 256)))
        build.add(fine, "good", 1 + 0.3 * coarse.classes)
    path: Path = build.write()
    return path


@pytest.mark.slow
def test_all_targets_are_drawn_as_classes_below_their_truth(run: Path) -> None:
    figure = draw_challenge(read_run(run), ["good"])
    shown = [np.asarray(axes.images[0].get_array()) for axes in figure.axes if axes.images]
    assert len(shown) == 2 * 21
    assert all(image.shape == (256, 256) for image in shown)
    agreement = [np.mean(t == f) for t, f in zip(shown[:21], shown[21:], strict=True)]
    assert min(agreement) > 0.97
    assert all(set(np.unique(image)) == {-1, 0} for image in shown)
    notes = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert sum(note.startswith("0.9") for note in notes) == 21
    grid = comparison(read_run(run), "ktc2023-level1")
    (truth, estimate), *_ = (tiles for _, tiles in grid.rows)
    assert truth.image is not None
    assert estimate.image is not None
    assert (truth.image.shape, estimate.image.shape) == ((256, 256), (40, 40))
    assert np.isnan(truth.image[0, 0])
    assert np.isfinite(truth.image[128, 128])


@pytest.mark.slow
def test_a_run_of_all_levels_gets_the_figure(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_grid, "draw", lambda grid: Figure(figsize=(1, 1)))
    assert run / "figures" / "challenge.png" in write_figures(run)


@pytest.mark.slow
def test_the_sum_is_in_the_report_and_in_every_printed_form(run: Path) -> None:
    """Where all levels are: 21 true targets, seen through pixels, get more than 20 of 21 points."""
    (found,) = findings([read_run(run)])
    best = found.grid[1]
    assert best[:2] == ["good", "default"]
    assert 20 < float(best[-1]) < 21
    assert float(best[-1]) == pytest.approx(sum(map(float, best[2:-1])), abs=0.05)
    page = to_page(report_data([run]), found=[found])
    assert f"<td>{best[-1]}</td>" in page
    assert "<td>15.24</td>" in page
    rows = ranked_rows([run])
    assert f"<td>{best[-1]}</td>" in FORMATS["html"](rows)
    assert f" & {best[-1]} \\\\" in FORMATS["latex"](rows)
    six = [row for row in rows if row["scenario"] != "ktc2023-level7"]
    assert all("15.24" not in form(six) for form in FORMATS.values())
