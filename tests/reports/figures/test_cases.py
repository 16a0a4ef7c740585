"""The published cases: which samples they are, and when they are shown."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.figures import assert_no_text_overlaps_or_is_cut
from tests.support.made_runs import made

from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.studies.reproduce import METHODS
from eitbench.reports.figures.cases import published_cases
from eitbench.reports.figures.image_grid import draw
from eitbench.scenarios.data.datasets import Dataset

FAMILIES = ["circle", "two-circles", "l-shape", "triangle", "rectangle", "ring"]


@pytest.fixture
def paper() -> Dataset:
    """14 samples of the published families in turn, as in the scenario `paper`."""
    data = made("conductivity", 14, scenario="paper")
    data.samples["family"] = [FAMILIES[k % 6] for k in range(14)]
    return data


def run_of(build: Any, data: Dataset, methods: tuple[str, ...]) -> Run:
    build.suite = "paper"
    for k, name in enumerate(methods):
        build.add(data, name, np.array(data.conductivity) + 0.1 * k)
    return read_run(build.write())


@pytest.mark.slow
def test_cases_are_the_first_samples_of_their_families(build: Any, paper: Dataset) -> None:
    ((scenario, grid),) = published_cases(run_of(build, paper, METHODS[::-1]))
    assert scenario == "paper"
    assert grid.columns == ("truth", *METHODS)
    assert [label[:3] for label, _ in grid.rows] == [
        (f"case {number}", family, f"sample {sample}")
        for number, family, sample in (
            (1, "two-circles", 1), (2, "two-circles", 7), (3, "two-circles", 13),
            (4, "triangle", 3), (5, "ring", 5), (6, "l-shape", 2), (7, "rectangle", 4),
        )
    ]  # fmt: skip
    assert paper.conductivity is not None
    for (label, tiles), sample in zip(grid.rows, (1, 7, 13, 3, 5, 2, 4), strict=True):
        for tile, offset in zip(tiles, (0.0, 0.3, 0.2, 0.1, 0.0), strict=True):
            assert tile.image is not None
            np.testing.assert_allclose(tile.image, paper.conductivity[sample] + offset, atol=1e-6)
        assert label[2] == f"sample {sample}"
    assert [len(tile.note) for tile in grid.rows[0][1]] == [0, 2, 2, 2, 2]  # four metrics
    assert_no_text_overlaps_or_is_cut(draw(grid))


@pytest.mark.slow
def test_runs_without_a_method_or_a_family_have_no_cases(
    build: Any, paper: Dataset, build_operators: Callable[..., Path]
) -> None:
    assert list(published_cases(read_run(build_operators({"fem": 1e-9})))) == []
    assert list(published_cases(run_of(build, paper, METHODS[1:]))) == []
    paper.samples["family"] = paper.samples["family"].replace("ring", "star")
    build.samples.clear()
    assert list(published_cases(run_of(build, paper, METHODS))) == []
