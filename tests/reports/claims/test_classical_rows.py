"""Readings of the published classical rows: consistent or not, never proven."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.claims.classical_rows import classical_readings
from eitbench.reports.claims.evidence import Evidence
from eitbench.scenarios.data.datasets import Dataset

Run = Path


@pytest.fixture
def run(build: Any, paper: Dataset) -> Run:
    """NOSER with half of the contrast, TV that saw nothing."""
    truth = np.array(paper.conductivity)
    build.suite = "paper"
    build.add(paper, "noser", 0.5 * (truth - 1) + 1)
    build.add(paper, "tv", np.ones_like(truth))
    path: Path = build.write()
    return path


def test_readings_are_called_consistent_and_never_proven(run: Run) -> None:
    readings = classical_readings(Evidence([read_run(run)]))
    noser, tv = readings["methods"]
    *names, scaled = (row["reading"] for row in noser["rows"])
    assert names == [
        "published", "absolute map", "difference image", "difference, sign reversed",
    ]  # fmt: skip
    assert "times as strong" in scaled
    assert "is consistent with" in noser["says"]
    assert "does not exclude other explanations" in noser["says"]
    # An image that shows nothing has no strength that would give the published error.
    assert len(tv["rows"]) == 4
    assert "consistent" not in tv["says"]
    assert "absolute maps" in readings["says"]
    assert "prove" not in noser["says"] + tv["says"] + readings["says"]


def test_figures_that_do_not_fit_are_not_called_consistent(build: Any, paper: Dataset) -> None:
    """An image unlike any touch: the RIE can be had by its scale, the SSIM is not near 0."""
    truth = np.array(paper.conductivity)
    build.suite = "paper"
    build.add(paper, "noser", 1 + truth)
    noser, _ = classical_readings(Evidence([read_run(build.write())]))["methods"]
    assert "is not consistent with that either" in noser["says"]


def test_without_a_run_there_is_a_reason_for_no_reading() -> None:
    readings = classical_readings(Evidence([]))
    assert readings["constants"] == []
    for method, name in zip(readings["methods"], ("noser", "tv"), strict=True):
        assert [row["reading"] for row in method["rows"]] == ["published"]
        assert method["says"] == ""
        assert repr(name) in method["conditions"]
