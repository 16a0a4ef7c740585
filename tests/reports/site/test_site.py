"""The site: pages whose links lead somewhere, and which say what stored runs say."""

import hashlib
import html
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest, note_version
from typer.testing import CliRunner

from eitbench.benchmark.analysis.catalogue import about_method
from eitbench.benchmark.analysis.results import SHOWN
from eitbench.benchmark.submissions.hidden import Gap, HiddenRecord, PublishedKey, write_hidden
from eitbench.benchmark.submissions.rerun import digest
from eitbench.benchmark.submissions.sums import note_sums
from eitbench.commands.results import app
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.reports.findings.finding import Finding
from eitbench.reports.site import pages
from eitbench.reports.site.edition import Edition, editions
from eitbench.reports.site.pages import hidden_keys
from eitbench.reports.site.site import write_site
from eitbench.reports.site.stated import method_stated_table, stated_tables
from eitbench.reports.tables.leaderboard import FORMATS, ranked_rows
from eitbench.scenarios import progress
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.suites.suite import suites

pytestmark = pytest.mark.slow

SAID = {
    "name": "Mine of 2026", "authors": ["A. Author", "B. Other"], "contact": "a@example.org",
    "code": "https://example.org/mine", "commit": "c" * 40, "container": "", "licence": "MIT",
    "training_data": "Nothing <b>at all</b>.", "test_split_seen": False,
}  # fmt: skip
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


def test_every_link_leads_to_a_file(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "site"
    written = write_site(runs, out).pages
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
    monkeypatch.setattr(progress, "LINE_SECONDS", 0.0)
    result = CliRunner().invoke(app, ["site", str(runs), "--out", str(out)])
    assert "damaged is left out: " in result.stderr
    assert "Pages of suites: 1 of 1" in result.stderr


def test_a_method_has_what_eitbench_says_of_it(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    write_site(runs, out)
    page = (out / "methods" / "noser.html").read_text()
    assert "Cheney et al., NOSER" in page
    assert 'href="https://doi.org/10.1002/ima.1850020203"' in page
    assert "code/methods/classical/noser.py.txt" in page
    assert '@register("noser")' in (out / "code/methods/classical/noser.py.txt").read_text()
    assert "eitbench run bench.toml --scenarios conductivity-set --methods noser" in page
    assert (out / "images" / "bench" / "noser.png").read_bytes().startswith(b"\x89PNG")


def test_every_method_with_packaged_weights_has_a_page(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    """Each file of weights says of its training what it knows."""
    trained = {
        name: about.trained for name in METHOD_REGISTRY.known() if (about := about_method(name))
    }
    trained = {name: of for name, of in trained.items() if of}
    assert len(trained) > 5
    build.add_scaled(dataset_of("conductivity", 12), dict.fromkeys(trained, 0.9), noise=0.02)
    build.write()
    write_site(tmp_path, tmp_path / "site")
    for name, sensors in trained.items():
        page = html.unescape((tmp_path / "site" / "methods" / f"{name}.html").read_text())
        for sensor, entries in sensors.items():
            said = page.partition(f"Packaged weights for {sensor}")[2].partition("</dl>")[0]
            for what, value in entries.items():
                assert f"<dt>{what}</dt>" in said
                assert value in said
    refined = (tmp_path / "site" / "methods" / "learned-gn.html").read_text()
    assert "from the image of <code>dnn</code>" in refined


def test_files_of_others_and_runs_are_not_replaced(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run, mine = build.write(), tmp_path / "mine"
    mine.mkdir()
    (mine / "submit.html").write_text("mine")
    with pytest.raises(InputError, match=r"holds files of others, such as submit\.html"):
        write_site(run.parent, mine)
    assert [path.read_text() for path in mine.iterdir()] == ["mine"]
    with pytest.raises(InputError, match="is a run directory"):
        write_site(run.parent, run)
    assert not (run / "index.html").exists()
    out = tmp_path / "documented"
    (out / "docs").mkdir(parents=True)
    (out / "docs" / "index.html").write_text("<title>Documentation</title>")
    write_site(run.parent, out)


def test_the_front_counts_what_methods_win(build: Any, dataset_of: Any, tmp_path: Path) -> None:
    for name in ("one", "two"):
        build.add_scaled(dataset_of("conductivity", 12, name), {"good": 0.9, "poor": 0.2})
    build.write()
    (front, *_) = write_site(tmp_path, tmp_path / "site").pages
    assert cells(front.read_text(), "Over all suites") == [
        ["good", "100%", "1", "–", "1 of 2"],
        ["poor", "0%", "1", "–", "2 of 2"],
    ]
    page = (tmp_path / "site" / "suites" / "bench.html").read_text()
    assert cells(page, "Over the 2 scenarios") == [["good", "1.00", "100%"], ["poor", "2.00", "0%"]]


def test_boards_have_the_ceiling_unranked_and_say_what_their_columns_hold(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ceiling(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [dict.fromkeys(rows[0]) | {"method": "ceiling", "n": 5, "psnr": 41.23}]

    monkeypatch.setattr(pages, "ceiling_rows", ceiling)
    write_site(runs, tmp_path / "site")
    page = (tmp_path / "site" / "suites" / "bench.html").read_text()
    board = cells(page, "conductivity-set")
    assert [row[0] for row in board][-1] == "ceiling"
    assert "41.23" in board[-1]
    assert board[-1][1] == "–"
    assert board[0][:2] == ["noser", "1"]
    assert "Ties: methods that share a letter cannot be told apart" in page
    assert not (tmp_path / "site" / "methods" / "ceiling.html").exists()


def test_pages_have_what_methods_state_of_their_images(runs: Path) -> None:
    (edition,) = editions(runs)
    stated = pd.DataFrame(
        [
            {"scenario": "a", "rank": 1.0, "method": "noser", "crps": 0.01234, "coverage_95": 0.9},
            {"scenario": "a", "rank": None, "method": "ceiling", "crps": 0.01, "coverage_95": 0.95},
        ]
    )
    told = pd.DataFrame(
        [
            {"scenario": "b", "method": "noser", "score": "residual", "auroc": 0.1},
            {"scenario": "a", "method": "noser", "score": "novelty", "auroc": 0.75},
        ]
    )
    grid = [["Scenario", "#", "Method", "CRPS"], ["a", "1", "noser", "0.0123"]]
    found = [
        Finding("uncertainty", "Uncertainty", stated, grid, "Ranked by CRPS."),
        Finding("novelty", "Novelty", told, [["Method", "a"], ["noser", "0.750"]], "AUROC."),
        Finding("other", "Other", told, [["Method"]], ""),
    ]
    suite = replace(edition.suites[0], found=found)
    first, second = stated_tables(suite)
    assert (first.heads, second.heads) == (["Method", "Scenario", "#", "CRPS"], ["Method", "a"])
    assert first.rows == [["noser", ("a", ""), ("1", "number"), ("0.0123", "number")]]
    table = method_stated_table("noser", replace(edition, suites=[suite]))
    assert table is not None
    assert [[str(getattr(cell, "text", cell)) for cell in row][1:] for row in table.rows] == [
        ["a", "1", "0.01234", "90.0%", "–", "0.750"]
    ]
    assert method_stated_table("tv", replace(edition, suites=[suite])) is None


def test_a_method_says_what_its_training_took(build: Any, dataset_of: Any, tmp_path: Path) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"dnn": 0.9, "noser": 0.5})
    run = build.write()
    table = pd.read_parquet(run / "methods.parquet")
    took = table["method"].map({"dnn": 6993.4})
    table.assign(train_s=took).to_parquet(run / "methods.parquet")
    write_site(tmp_path, tmp_path / "site")
    said = {
        name: (tmp_path / "site" / "methods" / f"{name}.html").read_text()
        for name in ("dnn", "noser")
    }
    assert "<dt>bench / conductivity-set</dt><dd>6,993 s</dd>" in said["dnn"]
    assert "What its training took" not in said["noser"]


def test_equals_share_the_mean_of_their_ranks(build: Any, dataset_of: Any, tmp_path: Path) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"one": 0.9, "two": 0.9, "poor": 0.2})
    build.write()
    (front, *_) = write_site(tmp_path, tmp_path / "site").pages
    ranks = {row[0]: row[-1] for row in cells(front.read_text(), "Over all suites")}
    assert ranks == {"one": "1.5 of 3", "two": "1.5 of 3", "poor": "3 of 3"}


def test_data_that_suites_share_count_once(
    run_builder: Any, dataset_of: Any, tmp_path: Path
) -> None:
    few, more = {"good": 0.9, "poor": 0.2}, {"good": 0.7, "poor": 0.8, "worst": 0.1}
    for suite, shares in (("a", few), ("b", few), ("c", more), ("d", few)):
        build = run_builder(tmp_path / "runs" / suite, suite)
        build.add_scaled(dataset_of("conductivity", 12, f"of-{suite}"), shares).write()
    (front, *_) = write_site(tmp_path / "runs", tmp_path / "site").pages
    assert "3 methods on 4 suites with 12 test frames" in front.read_text()
    rows = [row[:3] for row in cells(front.read_text(), "Over all suites")]
    assert rows == [["poor", "100%", "1"], ["good", "50%", "1"], ["worst", "0%", "1"]]
    # What the table is, and that it goes on, is said beside it.
    assert "column for each of 4 suites. Where it is cut, scroll it sideways." in front.read_text()
    assert "Green: in the first third of them; red: in the last third." in front.read_text()


def test_an_older_version_stands_beside_the_newest(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run = build.write()
    for version in ("2026.9", "2026.10"):
        shutil.copytree(run, tmp_path / "records" / version / "bench")
        note_version(tmp_path / "records" / version)
    out = tmp_path / "site"
    written = write_site(tmp_path / "records", out).pages
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
    # The lasting address of the newest version leads to it, until it stands there itself.
    lasting = out / "archive" / "2026.10" / "suites" / "bench.html"
    (to,) = re.findall(r'content="0; url=([^"]*)"', lasting.read_text())
    assert (lasting.parent / to).resolve() == out / "suites" / "bench.html"


def test_a_version_has_the_suites_of_the_one_before_that_it_lacks(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run, records = build.write(), tmp_path / "records"
    for name in ("2026.1/bench", "2026.1/other", "2026.2/other"):
        shutil.copytree(run, records / name)
        with edited_manifest(records / name) as content:
            content["plan"]["suite"]["name"] = Path(name).name
    for version in ("2026.1", "2026.2"):
        note_version(records / version)
    # What stopped commands leave: half a record, and a version without one.
    shutil.copytree(run, records / "2026.2" / ".bench.part")
    (records / "2026.3").mkdir()
    out = tmp_path / "site"
    (front, *_) = write_site(records, out).pages
    text = front.read_text()
    assert "<title>Leaderboard – eitbench 2026.2</title>" in text
    assert re.findall(r"run until [0-9-]+(, from version 2026.1)?", text) == [
        ", from version 2026.1", "",
    ]  # fmt: skip
    assert ", from version 2026.1" in (out / "suites" / "bench.html").read_text()
    assert ", from version" not in (out / "suites" / "other.html").read_text()


def test_a_version_that_lost_its_records_is_not_left_out(board: Path, tmp_path: Path) -> None:
    shutil.copytree(board, board.with_name("2026.2"))
    shutil.rmtree(board.with_name("2026.2") / "bench")
    with pytest.raises(DataCorruptError, match=r"2026\.2/bench/.* is gone"):
        write_site(board.parent, tmp_path / "site")


def test_pages_of_a_suite_whose_file_name_is_escaped_are_found(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    """Windows has no file `con.html`."""
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run = shutil.copytree(build.write(), tmp_path / "runs" / "one")
    with edited_manifest(run) as content:
        content["plan"]["suite"]["name"] = "con"
    for path in write_site(tmp_path / "runs", tmp_path / "site").pages:
        if path.parent.parent.name != "reports":
            for link in links(path):
                assert (path.parent / unquote(link)).is_file(), link


def _odd_parameters(run: Path) -> None:
    with edited_manifest(run) as content:
        content["cells"][0]["parameters"] = ["a"]


def _odd_recording(run: Path) -> None:
    with edited_manifest(run) as content:
        content["plan"]["suite"]["scenarios"] = [{"name": "odd", "recording": ["x"]}]


def _odd_uncertainty(run: Path) -> None:
    cells = pd.read_parquet(run / "methods.parquet").assign(uncertainty="[")
    cells.to_parquet(run / "methods.parquet", index=False)
    samples = pd.read_parquet(run / "samples.parquet").assign(uncertainty_ms=1.0, crps=0.1)
    samples.to_parquet(run / "samples.parquet", index=False)


@pytest.mark.parametrize("spoil", [_odd_parameters, _odd_recording, _odd_uncertainty])
def test_a_run_that_only_a_later_page_would_stumble_over_is_left_out(
    build: Any, dataset_of: Any, tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run, runs = build.write(), tmp_path / "runs"
    for name in ("one", "two"):
        shutil.copytree(run, runs / name)
    spoil(runs / "two")
    (front, *_) = write_site(runs, tmp_path / "site").pages
    assert "two is left out" in front.read_text()


def test_a_key_that_several_suites_share_is_published_for_all() -> None:
    shared = [
        PublishedKey(version="2026.1", suite=suite, sha256="a" * 64) for suite in ("one", "two")
    ]
    retired = shared[0].model_copy(update={"retired": "b" * 64})
    assert "secret" not in hidden_keys(Edition("2026.1", [], [], [retired, shared[1]]))
    assert hidden_keys(Edition("2026.1", [], [], shared)) == "The key of one, two is secret."


def test_a_run_whose_manifest_tells_nothing_of_its_resumption_is_left_out(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run, runs = build.write(), tmp_path / "runs"
    for name in ("one", "two"):
        shutil.copytree(run, runs / name)
    with edited_manifest(runs / "two") as content:
        content["resumed"] = [{}]
    (front, *_) = write_site(runs, tmp_path / "site").pages
    assert "two is left out" in front.read_text()


def test_a_site_in_the_place_of_another_one_has_no_pages_of_it(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run, runs, out = build.write(), tmp_path / "runs", tmp_path / "site"
    for name in ("one", "two"):
        shutil.copytree(run, runs / name)
    write_site(runs, out)
    (out / "CNAME").write_text("example.org")  # a host's own file
    assert list((out / "records" / "bench").iterdir())
    pages = {path.relative_to(out) for path in out.rglob("*.html")}
    shutil.rmtree(runs / "two")
    with edited_manifest(runs / "one") as content:
        content["plan"]["suite"]["name"] = "else"
    write_site(runs, out)
    assert not (out / "records" / "bench").exists()
    assert (out / "records" / "else").is_dir()
    assert (out / "CNAME").is_file()
    # A note that came from elsewhere deletes nothing outside, and nothing hidden.
    (tmp_path / "precious").write_text("mine")
    (out / "link").symlink_to(tmp_path)
    (out / ".git").mkdir()
    (out / ".git" / "config").write_text("mine")
    (out / "suites" / "old.html").write_text("old")
    said = ["link/precious", "../precious", str(tmp_path / "precious"), ".git/config", "suites"]
    (out / ".files.json").write_text(json.dumps([*said, "suites/old.html"]))
    write_site(runs, out)
    assert (tmp_path / "precious").is_file()
    assert (out / ".git" / "config").is_file()
    assert (out / "suites").is_dir()
    assert not (out / "suites" / "old.html").exists()
    left = pages - {path.relative_to(out) for path in out.rglob("*.html")}
    assert left == {Path("suites/bench.html"), Path("reports/bench/index.html")}


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


def test_operators_have_pages_too(build_operators: Any, tmp_path: Path) -> None:
    build_operators({"fem": 0.1, "jacobian": 0.3}, n=12)
    (front, *_) = write_site(tmp_path, tmp_path / "site").pages
    results = cells((front.parent / "methods" / "fem.html").read_text(), "Every result")
    assert [row[:3] for row in results] == [["operators", "paper", "1 of 2"]]


def test_the_front_says_of_how_many_suites_there_is_a_record(board: Path, tmp_path: Path) -> None:
    shutil.copytree(board / "bench", board / "quick")
    with edited_manifest(board / "quick") as content:
        content["plan"]["suite"]["name"] = "quick"
    note_version(board)
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    assert f"There is a record of 1 of {len(suites())} suites." in front.read_text()


def publish(board: Path, keys: dict[str, bytes], retired: bytes = b"") -> None:
    """Publish the hash of a key for each suite; one that is retired with the key itself."""
    lines = list[str]()
    for suite, key in keys.items():
        sha256 = hashlib.sha256(key).hexdigest()
        lines += ["[[keys]]", f'version = "{board.name}"', f'suite = "{suite}"']
        lines += [f'sha256 = "{sha256}"', *([f'retired = "{key.hex()}"'] if key == retired else ())]
    (board.parent / "hidden.toml").write_text("\n".join(lines))


def hidden_record(key: bytes, methods: list[str], scored: dict[str, float]) -> HiddenRecord:
    """Hidden figures of methods of which the open ones are `scored`."""
    gap = Gap(
        scenario="conductivity-set", method="", code=None, figure="score", n=12, clusters=4,
        open=0.0, hidden=4.0, difference=-1.0, low=-1.5, high=-0.5, p=0.001, falls=True,
    )  # fmt: skip
    return HiddenRecord(
        suite="bench", key=hashlib.sha256(key).hexdigest(), made="2026-01-01", eitbench="0.2.0",
        git_commit=None, data={"conductivity-set": ("3f2a1b9c", "1" * 64)},
        gaps=tuple(
            gap.model_copy(update={"method": method, "open": float(scored.get(method, 0))})
            for method in methods
        ),
    )  # fmt: skip


def test_hidden_figures_say_if_their_key_is_published(board: Path, tmp_path: Path) -> None:
    secret, retired = (bytes([k]) * 32 for k in (1, 2))
    samples = pd.read_parquet(board / "bench" / "samples.parquet")
    scored = {str(name): of["score"].mean() for name, of in samples.groupby("method")}
    # The figures of `poor` with the retired key are older than those with the secret one.
    for key, methods in ((retired, ["good", "poor"]), (secret, ["poor"])):
        publish(board, {"bench": key})
        write_hidden(hidden_record(key, methods, scored), board)
    publish(board, {"bench": retired, "other": secret}, retired)
    note_version(board)
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    page = (front.parent / "suites" / "bench.html").read_text()
    assert [(row[1], row[-1]) for row in cells(page, "On a hidden test set")] == [
        ("good", "key published"), ("poor", "key published"), ("poor", "key secret"),
    ]  # fmt: skip
    assert [(row[0], row[-1]) for row in cells(page, "conductivity-set")] == [
        ("good", "hidden (key published)"), ("poor", "hidden"),
    ]  # fmt: skip
    results = cells((front.parent / "methods" / "good.html").read_text(), "Every result")
    told = "hidden (key published), falls by more than chance; hidden minus open -1.000 (-1.500 to"
    assert results[0][6].startswith(told)
    submit = (front.parent / "submit.html").read_text()
    assert "The key of other is secret. The key of bench is published" in submit
    assert "nobody has seen" not in submit
    keys = board.parent / "hidden.toml"
    before = keys.read_text()
    publish(board, {"bench": bytes([3]) * 32})  # a new one
    keys.write_text(f"{before}\n{keys.read_text()}")
    note_version(board)
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    submit = (front.parent / "submit.html").read_text()
    assert "The key of bench, other is secret." in submit
    assert "is published" not in submit
    keys.unlink()
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    page = (front.parent / "suites" / "bench.html").read_text()
    table = cells(page, "On a hidden test set")
    assert {row[-1] for row in table} == {"key not known here"}


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


@pytest.fixture
def board(run_builder: Any, dataset_of: Any, tmp_path: Path) -> Path:
    """A record with two methods, two submissions of a third, one that has the record's name."""
    folder = tmp_path / "records" / "2026.1"
    data = dataset_of("conductivity", 12)
    record = run_builder(folder / "bench").add_scaled(data, {"good": 0.7, "poor": 0.2}).write()
    with edited_manifest(record) as content:
        content["images"] = SHOWN
    note_sums(sorted(record.iterdir()))
    for name, share in (("bench", 0.9), ("tank", 0.8)):
        run = run_builder(folder / "submissions" / "bench" / name)
        path = run.add_scaled(data, {"mine": share}).write()
        sha256 = digest_of(name)
        plugin = {"path": "mine.py", "sha256": sha256, "names": ["mine"], "sources": [""]}
        (path / "plugins").mkdir()
        (path / "plugins" / f"{sha256[:16]}.py").write_text(f"# {name} <code>")
        with edited_manifest(path) as content:
            content["plan"]["plugins"] = [plugin]
        (path / "submission.json").write_text(json.dumps(SAID | {"licence": f"LicenseRef-{name}"}))
    return folder


def digest_of(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def reproduced(board: Path, *names: str) -> None:
    folder = board / "submissions" / "bench"
    told = {digest(folder / name): "8 of 12 samples" for name in names}
    (folder / "reproduced.json").write_text(json.dumps(told))


def test_self_reported_submissions_are_shown_but_count_nowhere(board: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    (front, *_) = write_site(board.parent, out).pages
    assert [row[:2] for row in cells(front.read_text(), "Over all suites")] == [
        ["good", "100%"], ["poor", "0%"],
    ]  # fmt: skip
    assert "2 methods on 1 suite" in front.read_text()
    assert 'href="methods/mine.html"' in front.read_text()
    page = (out / "suites" / "bench.html").read_text()
    assert "good is the best" in page
    assert [(row[0], row[-1]) for row in cells(page, "conductivity-set")] == [
        ("good", "reproduced"), ("poor", "reproduced"),
    ]  # fmt: skip
    table = cells(page, "Self-reported, not ranked")
    assert [row[:3] + row[4:] for row in table] == [
        ["conductivity-set", "mine", name, "self-reported"] for name in ("bench", "tank")
    ]
    results = cells((out / "methods" / "mine.html").read_text(), "Every result")
    assert [row[2] for row in results] == ["not ranked", "not ranked"]
    results = cells((out / "methods" / "good.html").read_text(), "Every result")
    assert [row[2] for row in results] == ["1 of 2"]


def test_a_method_has_one_row_over_all_suites_whatever_runs_hold_it(
    board: Path, tmp_path: Path
) -> None:
    shutil.move(board / "submissions" / "bench" / "bench", board / "submissions" / "bench" / "a")
    reproduced(board, "a", "tank")
    out = tmp_path / "site"
    (front, *_) = write_site(board.parent, out).pages
    assert cells(front.read_text(), "Over all suites") == [
        ["mine", "100%", "1", "–", "1 of 3"],
        ["good", "50%", "1", "–", "2 of 3"],
        ["poor", "0%", "1", "–", "3 of 3"],
    ]
    page = (out / "suites" / "bench.html").read_text()
    assert [(row[0], row[-1]) for row in cells(page, "conductivity-set")] == [
        ("mine (a)", "reproduced"), ("mine (tank)", "reproduced"),
        ("good", "reproduced"), ("poor", "reproduced"),
    ]  # fmt: skip
    assert "Self-reported, not ranked" not in page
    assert "100% of its comparisons" in (out / "methods" / "mine.html").read_text()


def test_a_record_comes_before_submissions_and_frames_count_once(board: Path) -> None:
    shutil.move(board / "bench", board / "tank")  # after "submissions"
    note_version(board)
    reproduced(board, "bench")
    (edition,) = editions(board.parent)
    (suite,) = edition.suites
    assert [run.path.name for run in suite.runs] == ["tank", "bench"]
    # Records keep fewer digits of a hash, and another machine's hashes are others.
    first, other = suite.runs
    for run, hashes in ((first, first.samples["input_hash"].str[:16]), (other, "other")):
        run.samples["input_hash"] = hashes
    assert edition.frames == 12


def test_a_reproduced_submission_does_not_replace_a_record_of_its_name(
    board: Path, tmp_path: Path
) -> None:
    reproduced(board, "bench")
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    assert "bench is left out: suite bench has another folder of this name" in front.read_text()
    assert "good is the best" in (front.parent / "suites" / "bench.html").read_text()


def test_a_submission_without_a_record_to_stand_below_is_left_out(
    board: Path, tmp_path: Path
) -> None:
    shutil.copytree(board / "bench", board / "other")
    with edited_manifest(board / "other") as content:
        content["plan"]["suite"]["name"] = "other"
    shutil.rmtree(board / "bench")
    note_version(board)
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    assert "tank is left out: it is self-reported" in front.read_text()
    assert not (front.parent / "suites" / "bench.html").exists()


def test_hidden_figures_stand_beside_a_reproduced_submission_that_has_no_record(
    board: Path, tmp_path: Path
) -> None:
    reproduced(board, "tank")
    shutil.copytree(board / "bench", board / "other")
    with edited_manifest(board / "other") as content:
        content["plan"]["suite"]["name"] = "other"
    shutil.rmtree(board / "bench")
    key = bytes([1]) * 32
    publish(board, {"bench": key})
    write_hidden(hidden_record(key, ["good"], {}), board)
    note_version(board)
    (front, *_) = write_site(board.parent, tmp_path / "site").pages
    page = (front.parent / "suites" / "bench.html").read_text()
    assert [row[1] for row in cells(page, "On a hidden test set")] == ["good"]


@pytest.mark.parametrize("name", ["samples.parquet", "manifest.json"])
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda path: path.write_bytes(path.read_bytes() + b" "), "is not the file that"),
        (lambda path: path.unlink(), "is gone"),
        (lambda path: shutil.copy(path, path.with_name("other")), "other is not noted in"),
    ],
    ids=["changed", "gone", "one more"],
)
def test_a_record_that_is_not_as_it_was_noted_is_not_shown(
    board: Path, tmp_path: Path, name: str, change: Callable[[Path], object], said: str
) -> None:
    change(board / "bench" / name)
    with pytest.raises(DataCorruptError, match=f"{said}.*: published records are never edited"):
        write_site(board.parent, tmp_path / "site")
    assert not (tmp_path / "site").exists()


def test_no_run_takes_the_place_of_another_one(board: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    for page in write_site(board.parent, out).pages:
        if page.parent.parent.name != "reports":
            for link in links(page):
                assert (page.parent / unquote(link)).is_file(), link
    copies = {path.parent.relative_to(out): path for path in out.rglob("samples.parquet")}
    for where, source in {
        "records/bench/bench": board / "bench",
        "submissions/bench/bench": board / "submissions" / "bench" / "bench",
        "submissions/bench/tank": board / "submissions" / "bench" / "tank",
    }.items():
        original = source / "samples.parquet"
        assert copies.pop(Path(where)).read_bytes() == original.read_bytes()
    assert not copies


def test_what_an_author_states_stands_by_the_run_and_by_the_method(
    board: Path, tmp_path: Path
) -> None:
    out = tmp_path / "site"
    write_site(board.parent, out)
    for page in ("suites/bench.html", "methods/mine.html"):
        text = (out / page).read_text()
        for said in (
            "Mine of 2026", "A. Author, B. Other", "cccccccccc", "LicenseRef-tank",
            "LicenseRef-bench",
            'href="https://example.org/mine"', "Nothing &lt;b&gt;at all&lt;/b&gt;.",
        ):  # fmt: skip
            assert said in text, said
        assert "a@example.org" not in text  # an address would be found by machines
        for name in ("bench", "tank"):
            copy = f"submissions/bench/{name}/{digest_of(name)[:16]}.py.txt"
            assert f'href="../{copy}"' in text
            assert (out / copy).read_text() == f"# {name} <code>"
    assert "Mine of 2026" not in (out / "methods" / "good.html").read_text()


def test_no_file_outside_a_submission_is_shown_as_its_plugin(board: Path, tmp_path: Path) -> None:
    (board / "submissions" / "bench" / "s.py").write_text("secret")
    with edited_manifest(board / "submissions" / "bench" / "tank") as content:
        content["plan"]["plugins"][0]["sha256"] = "../../s"
    write_site(board.parent, tmp_path / "site")
    assert not list((tmp_path / "site").rglob("s.py*"))
