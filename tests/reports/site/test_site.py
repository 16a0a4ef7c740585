"""The site: pages whose links lead somewhere, and which say what stored runs say."""

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
from eitbench.reports.site.site import write_site
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.scenarios.errors import InputError

pytestmark = pytest.mark.slow

NASTY = "<img src=x>/..%2F"


def measured_on(run: Path, machine: str, calibration_ms: float) -> None:
    table = pd.read_parquet(run / "methods.parquet")
    table.assign(machine=machine, calibration_ms=calibration_ms).to_parquet(run / "methods.parquet")


@pytest.fixture
def runs(build: Any, dataset_of: Any, tmp_path: Path) -> Path:
    """Two runs of a suite on unlike machines, and one that is damaged."""
    build.add_scaled(dataset_of("conductivity", 12), {"noser": 0.9, NASTY: 0.2}, noise=0.02)
    folder = tmp_path / "runs"
    first = shutil.copytree(build.write(), folder / "first")
    measured_on(first, "One", 20.0)
    measured_on(shutil.copytree(first, folder / "second"), "Another", 40.0)
    damaged = shutil.copytree(first, folder / "damaged")
    (damaged / "samples.parquet").write_bytes(b"x")
    return folder


def links(page: Path) -> list[str]:
    return [
        link.partition("#")[0]
        for link in re.findall(r'(?:href|src)="([^"#][^"]*)"', page.read_text())
        if not link.startswith(("https:", "data:"))
    ]


def cells(page: str, title: str) -> list[list[str]]:
    """The texts of the table under a heading."""
    table = page.partition(f"{title}</h2>")[2].partition("<tbody>")[2].partition("</tbody>")[0]
    rows = re.findall(r"<tr>(.*?)</tr>", table, flags=re.DOTALL)
    return [
        [re.sub(r"<[^>]+>", "", cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)]
        for row in rows
    ]


def test_every_link_leads_to_a_file(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    written = write_site(runs, out)
    assert {str(path.relative_to(out)) for path in written} == {
        "index.html", "submit.html", "suites/bench.html", "reports/bench/index.html",
        "methods/noser.html",
        "methods/%3Cimg%20src%3Dx%3E%2F..%252F~c31d63be45b239cf.html",
    }  # fmt: skip
    for path in written:
        assert "<img src=x" not in path.read_text()
        if path.parent.parent.name != "reports":
            for link in links(path):
                assert (path.parent / unquote(link)).is_file(), link
    assert "damaged is left out" in written[0].read_text()


def test_a_method_has_what_eitbench_says_of_it(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    write_site(runs, out)
    page = (out / "methods" / "noser.html").read_text()
    assert "Cheney et al., NOSER" in page
    assert 'href="https://doi.org/10.1002/ima.1850020203"' in page
    assert "code/methods/classical/noser.py.txt" in page
    assert '@register("noser")' in (out / "code/methods/classical/noser.py.txt").read_text()
    assert "eitbench run bench --scenarios conductivity-set --methods noser" in page
    assert (out / "images" / "bench" / "noser.png").read_bytes().startswith(b"\x89PNG")


def test_the_front_counts_what_methods_win(build: Any, dataset_of: Any, tmp_path: Path) -> None:
    for name in ("one", "two"):
        build.add_scaled(dataset_of("conductivity", 12, name), {"good": 0.9, "poor": 0.2})
    build.write()
    (front, *_) = write_site(tmp_path, tmp_path / "site")
    assert cells(front.read_text(), "Over all suites") == [
        ["good", "100%", "1", "no", "1 of 2"],
        ["poor", "0%", "1", "no", "2 of 2"],
    ]
    page = (tmp_path / "site" / "suites" / "bench.html").read_text()
    assert cells(page, "Over the 2 scenarios") == [["good", "1.00", "100%"], ["poor", "2.00", "0%"]]


def test_data_that_suites_share_count_once(
    run_builder: Any, dataset_of: Any, tmp_path: Path
) -> None:
    few, more = {"good": 0.9, "poor": 0.2}, {"good": 0.7, "poor": 0.8, "worst": 0.1}
    for suite, shares in (("a", few), ("b", few), ("c", more)):
        build = run_builder(tmp_path / "runs" / suite, suite)
        build.add_scaled(dataset_of("conductivity", 12, f"of-{suite}"), shares).write()
    (front, *_) = write_site(tmp_path / "runs", tmp_path / "site")
    assert "3 methods on 3 suites with 12 test frames" in front.read_text()
    rows = [row[:3] for row in cells(front.read_text(), "Over all suites")]
    assert rows == [["poor", "100%", "1"], ["good", "50%", "1"], ["worst", "0%", "1"]]


def test_an_older_version_stands_beside_the_newest(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run = build.write()
    for version in ("2026.9", "2026.10"):
        shutil.copytree(run, tmp_path / "records" / version / "bench")
    out = tmp_path / "site"
    written = write_site(tmp_path / "records", out)
    assert "2026.10" in re.findall(r"<title>(.*?)</title>", written[0].read_text())[0]
    older = out / "archive" / "2026.9"
    assert "This is version 2026.9" in (older / "suites" / "bench.html").read_text()
    for path in written:
        if path.parent.parent.name != "reports":
            for link in links(path):
                assert (path.parent / unquote(link)).is_file(), f"{path}: {link}"
    front = (older / "index.html").read_text()
    assert 'href="../../index.html"' in front
    assert 'href="../../archive/2026.9/index.html"' in front


def test_times_of_several_machines_are_shown_in_calibration_solves(runs: Path) -> None:
    one = ranked_rows([runs / "first"])
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
    solves = {row["run"]: row["frame_solves"] for row in several if row["method"] == "noser"}
    assert solves["first"] == pytest.approx(2 * solves["second"])


def test_a_folder_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run directory"):
        write_site(tmp_path, tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_runs_whose_methods_were_run_again_say_so(runs: Path, tmp_path: Path) -> None:
    (runs / "reproduced.json").write_text(json.dumps({digest(runs / "first"): "32 of 36 samples"}))
    with edited_manifest(runs / "second") as content:
        for cell in content["cells"]:
            cell["parameters"] = {"weight": 1.0}  # else it repeats the first
    write_site(runs, tmp_path / "site")
    page = (tmp_path / "site" / "methods" / "noser.html").read_text()
    checked = [row[6] for row in cells(page, "Every result")]
    assert sorted(checked) == ["reproduced on 32 of 36 samples", "self-reported"]
    report = (tmp_path / "site" / "reports" / "bench" / "index.html").read_text()
    assert "reproduced on 32 of 36 samples" in report
