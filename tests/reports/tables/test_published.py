"""Table II beside what is measured: on the paper's scenario only, and never as a result."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitbench.reports.tables.boards import note
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.reports.tables.published import TABLE_II, published_rows
from eitbench.scenarios.data.datasets import Dataset

FORMS = ["md", "latex", "html", "terminal"]


@pytest.fixture
def rows(build: Any, paper: Dataset) -> list[dict[str, Any]]:
    return ranked_rows([of_scenario(build, paper, "paper")])


def of_scenario(build: Any, paper: Dataset, scenario: str) -> Path:
    dataset = dataclasses.replace(paper, scenario=scenario)
    dataset.__dict__["conductivity"] = images = paper.conductivity
    assert images is not None
    build.add(dataset, "tv", 0.9 * (images - 1) + 1)
    build.add(dataset, "noser", np.ones_like(images))
    path: Path = build.write()
    return path


@pytest.mark.parametrize("form", FORMS)
def test_the_published_methods_stand_below_ours(
    form: str, rows: list[dict[str, Any]], printed: Callable[..., str]
) -> None:
    text = printed(rows, form)
    places = [text.index(f"{name} (published)") for name in ("noser", "tv", "dnn", "phydnn")]
    assert text.index("noser") < min(places)
    assert places == sorted(places)
    for figure in ("0.975", "0.0295", "0.0290", "33.12", "1.2130", "-1.08", "-3.35"):
        assert figure in text
    plain = " ".join(text.replace("\\", "").split())
    assert "Table II, on its own data" in plain
    assert "inverse crime" in plain


def test_what_is_not_known_is_none(rows: list[dict[str, Any]]) -> None:
    published = {row["method"].split(" ")[0]: row for row in published_rows(rows)}
    assert set(published) == {"phydnn", "dnn", "noser", "tv"}
    for name, row in published.items():
        assert set(row) == set(rows[0])
        known = {key for key, value in row.items() if value is not None}
        assert known == {"method", *TABLE_II[name]}
    assert published["phydnn"]["score"] is None


def test_they_are_no_results(rows: list[dict[str, Any]]) -> None:
    for form in ("json", "csv"):
        assert "published" not in FORMATS[form](rows)
    assert json.loads(FORMATS["json"](rows)) == rows
    lines = FORMATS["md"](rows).splitlines()
    assert not any("**" in line for line in lines if "(published)" in line)
    (best,) = (line for line in lines if line.startswith("| 1 | tv |"))
    assert "**" in best  # although the published PhyDNN has more


@pytest.mark.parametrize("scenario", ["paper-30db", "paper-finer", "conductivity-set"])
def test_other_scenarios_have_none(scenario: str, build: Any, paper: Dataset) -> None:
    rows = ranked_rows([of_scenario(build, paper, scenario)])
    assert published_rows(rows) == []
    assert note([row | {"why_not": ""} for row in rows]) == ""
    assert "published" not in FORMATS["md"](rows)


def test_table_ii_is_that_of_the_paper(paper_text: str) -> None:
    rows = {"SSIM": "ssim", "CC": "cc", "RIE": "rie", r"PSNR \(dB\)": "psnr"}
    for title, name in rows.items():
        line = re.search(rf"^{title} \$\\\w+\$\s*&(.*)\\\\", paper_text, re.MULTILINE)
        assert line is not None
        printed = [float(part) for part in line[1].split("&")]
        assert printed == [TABLE_II[method][name] for method in ("noser", "tv", "dnn", "phydnn")]
