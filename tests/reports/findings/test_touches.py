"""The findings of a run as files, and in its report."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest
from tests.support.reports import report_data

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.findings.collect import findings, write_findings
from eitbench.reports.findings.touches import alarm_grid
from eitbench.reports.page.report import to_page

N = 60


@pytest.fixture
def presses(build: Any, dataset_of: Any) -> Path:
    """A run of recorded presses whose error grows, and of pairs at two distances."""
    data = dataset_of("position", N, "skin")
    build.add_scaled(data, {"good": 0.9, "poor": 0.5})
    build.add_scaled(dataset_of("position", N, "pairs"), {"good": 0.9})
    folder: Path = build.write()
    samples = pd.read_parquet(folder / "samples.parquet")
    pairs = samples["scenario"] == "pairs"
    samples["localisation_mm"] = 1.0 + samples["sample"] // (N // 5)
    samples["expected_x_m"] = 0.0
    samples.loc[pairs, "contacts"] = 2
    samples.loc[pairs, "probe_distance_mm"] = np.where(samples["sample"][pairs] % 2, 20.0, 90.0)
    samples.loc[pairs, "farthest_contact_mm"] = 12.0
    samples.loc[pairs, "contact_count_error"] = 0.0
    samples.to_parquet(folder / "samples.parquet")
    with edited_manifest(folder) as content:
        content["plan"]["suite"]["scenarios"] = [
            {"kind": "recorded", "name": name} for name in ("skin", "pairs")
        ]
    return folder


@pytest.mark.slow
def test_tables_and_figures_of_a_run(presses: Path) -> None:
    names = {path.relative_to(presses).as_posix() for path in write_findings(presses)}
    stems = ("over-time", "two-touch")
    assert names == {
        *(f"{stem}.{form}" for stem in stems for form in ("md", "csv")),
        *(f"figures/{stem}.{form}" for stem in stems for form in ("png", "pdf", "svg")),
    }
    with (presses / "over-time.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["method"] == "poor"]
    assert [float(row["error_mm"]) for row in rows] == [1, 2, 3, 4, 5]
    text = (presses / "two-touch.md").read_text()
    assert "| pairs | good | 0% | 100% | 90 mm | 100% | – |" in text
    text = (presses / "over-time.md").read_text()
    assert "| skin | good | 1.0 (1.0 to 1.0) | 3.0 (3.0 to 3.0) | 5.0 (5.0 to 5.0) |" in text


@pytest.mark.slow
def test_the_report_shows_them(presses: Path) -> None:
    page = to_page(report_data([presses]), found=findings([read_run(presses)]))
    assert "Error over time</h2>" in page
    assert "Two touches at once</h2>" in page
    assert page.count("A line for each method; the table below has the figures") == 2


def test_a_run_without_presses_has_none(full_run: Path) -> None:
    assert write_findings(full_run) == []


def test_alarms_in_words() -> None:
    row = {
        "scenario": "damage", "method": "noser", "false_start": 1.0, "false_before": 0.02,
        "cut": "B", "delay_s": 8.0, "lasting": 1.26, "during_mm": 12.2, "place_mm": 30.6,
    }  # fmt: skip
    silent = row | {"cut": "C", "delay_s": np.nan, "during_mm": np.nan, "place_mm": np.nan}
    heads, line = alarm_grid(pd.DataFrame([row, silent]))
    assert line == ["noser", "100%", "2%", "8 s", "1.3", "12, 31", "none", "1.3", "–"]
    assert len(heads) == len(line)
