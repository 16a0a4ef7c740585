"""Figures on pages of results are those of the stored runs."""

import re
from pathlib import Path

import pandas as pd
import pytest

DOCS = Path(__file__).parents[2] / "docs"
SCENARIOS = ["noise-clean", "noise-60db", "noise-50db", "noise-40db", "noise-30db", "shapes"]


def test_the_table_of_both_generators_is_that_of_the_stored_runs() -> None:
    stored = pd.read_csv(DOCS / "studies" / "generator" / "generators.csv")
    psnr = stored.set_index(["generator", "scenario", "method"])["psnr"]
    text = (DOCS / "results" / "data.md").read_text()
    rows = re.findall(r"^\| `([a-z-]+)` \| (.* → .*) \|$", text, re.MULTILINE)
    assert {method for method, _ in rows} == set(stored["method"])
    for method, cells in rows:
        for scenario, cell in zip(SCENARIOS, cells.split(" | "), strict=True):
            shown = [float(part) for part in cell.split(" → ")]
            expected = [psnr[generator, scenario, method] for generator in (1, 2)]
            assert shown == pytest.approx(expected, abs=0.006)
    assert (stored["n"] == 120).all()
