"""The site: pages for suites, methods and versions, whose links lead somewhere."""

import json
import re
import shutil
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest

from eitbench.benchmark.analysis.rerun import digest
from eitbench.reports.page.site import write_site
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.scenarios.errors import InputError

pytestmark = pytest.mark.slow

NASTY = "<img src=x>/..%2F"


def made_by(run: Path, version: str) -> None:
    with edited_manifest(run) as content:
        content["versions"] = {"eitbench": version}


def measured_on(run: Path, machine: str, calibration_ms: float) -> None:
    table = pd.read_parquet(run / "methods.parquet")
    table.assign(machine=machine, calibration_ms=calibration_ms).to_parquet(run / "methods.parquet")


@pytest.fixture
def runs(build: Any, dataset_of: Any, tmp_path: Path) -> Path:
    """Two runs with version 0.2.0, on unlike machines, one with 0.1.0, and one that is damaged."""
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, NASTY: 0.2}, noise=0.02)
    folder = tmp_path / "runs"
    first = shutil.copytree(build.write(), folder / "first")
    made_by(first, "0.1.0")
    measured_on(first, "One", 20.0)
    second = shutil.copytree(first, folder / "second")
    measured_on(second, "Another", 40.0)
    old = shutil.copytree(first, folder / "old")
    made_by(old, "0.0.9")
    damaged = shutil.copytree(first, folder / "damaged")
    (damaged / "samples.parquet").write_bytes(b"x")
    return folder


def test_every_link_leads_to_a_page(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    written = write_site(runs, out)
    assert {str(path.relative_to(out)) for path in written} == {
        "index.html", "guide.html", "archive/0.1.0/bench.html", "archive/0.0.9/bench.html",
        "methods/good.html", "methods/%3Cimg%20src%3Dx%3E%2F..%252F~c31d63be45b239cf.html",
    }  # fmt: skip
    for path in written:
        page = path.read_text()
        assert "<img" not in page
        for link in re.findall(r'href="([^"#]+)"', page):
            assert (path.parent / unquote(link)).is_file(), link
    front = written[0].read_text()
    assert front.index("archive/0.1.0/bench.html") < front.index("archive/0.0.9/bench.html")
    assert "damaged is left out" in front


def test_a_method_has_its_history(runs: Path, tmp_path: Path) -> None:
    write_site(runs, tmp_path / "site")
    page = (tmp_path / "site" / "methods" / "good.html").read_text()
    versions = re.findall(r"<td class=\"text\">(0\.\d\.\d)</td>", page)
    assert versions == ["0.1.0", "0.1.0", "0.0.9"]
    assert "eitbench run bench --scenarios conductivity-set --methods good" in page


def test_the_front_sums_up_the_scenarios_of_a_suite(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    for name in ("one", "two"):
        build.add_scaled(dataset_of("conductivity", 12, name), {"good": 0.9, "poor": 0.2})
    made_by(build.write(), "0.1.0")
    (front, *_) = write_site(tmp_path, tmp_path / "site")
    table = front.read_text().partition("Over all scenarios of a suite</h2>")[2]
    texts = re.findall(r"<td class=\"text\">([^<]+)</td>", table.partition("</table>")[0])
    assert texts == ["good", "1.00", "100%", "–", "2", "poor", "2.00", "0%", "–", "2"]


def test_times_of_several_machines_are_shown_in_calibration_solves(runs: Path) -> None:
    one = ranked_rows([runs / "first", runs / "old"])
    assert "Frame p50" in FORMATS["md"](one)
    assert "calibration solves" not in FORMATS["md"](one)
    with edited_manifest(runs / "second") as content:
        for cell in content["cells"]:
            cell["parameters"] = {"weight": 1.0}  # else it repeats the first
    several = ranked_rows([runs / "first", runs / "second"])
    text = FORMATS["md"](several)
    assert "calibration solves" in text
    assert "Frame p50" not in text
    assert "p99" not in text
    solves = {row["run"]: row["frame_solves"] for row in several if row["method"] == "good"}
    assert solves["first"] == pytest.approx(2 * solves["second"])


def test_a_folder_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run directory"):
        write_site(tmp_path, tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_runs_whose_methods_were_run_again_say_so(runs: Path, tmp_path: Path) -> None:
    (runs / "verified.json").write_text(json.dumps({digest(runs / "first"): "32 of 36 samples"}))
    write_site(runs, tmp_path / "site")
    page = (tmp_path / "site" / "methods" / "good.html").read_text()
    told = re.findall(r">(first|second|old)</td><td[^>]*>([^<]*)</td>", page.replace("\n", ""))
    assert dict(told) == {
        "first": "verified on 32 of 36 samples", "second": "self-reported", "old": "self-reported"
    }  # fmt: skip
    board = (tmp_path / "site" / "archive" / "0.1.0" / "bench.html").read_text()
    assert "verified on 32 of 36 samples" in board
