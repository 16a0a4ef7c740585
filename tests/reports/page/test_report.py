"""The report as data, page and files for a paper; `test_report_in_a_browser.py` opens it."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest
from tests.support.reports import report_data
from typer.testing import CliRunner

from eitbench.benchmark.analysis.results import read_run
from eitbench.commands.results import app as results
from eitbench.reports.figures.style import STYLE
from eitbench.reports.page import report
from eitbench.reports.page.answer import answer, summary
from eitbench.reports.page.images import FEW_STEPS, STEPS, packed_images, unpacked
from eitbench.reports.page.paper import (
    comparison,
    fastest_for_quality,
    frontier,
    noise,
    paper_figures,
)
from eitbench.reports.page.report import to_page, write_report
from eitbench.reports.page.report_data import (
    MOST_SINGLE,
    counted_data,
    name_kinds,
    overall_views,
    report_of,
)
from eitbench.reports.site.images import extremes
from eitbench.reports.site.site import write_site
from eitbench.scenarios.errors import DataCorruptError, InputError

NASTY = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def made_once(tmp_path_factory: pytest.TempPathFactory, run_builder: Any, dataset_of: Any) -> Path:
    """Enough samples for intervals: two methods that tie, one that is worse, a nasty name."""
    build = run_builder(tmp_path_factory.mktemp("many") / "run")
    shares = {"good": 0.9, "as-good": 0.9, "poor": 0.5, NASTY: 0.2}
    build.add_scaled(dataset_of("conductivity", 24), shares, noise=0.02)
    folder: Path = build.write()
    return folder


@pytest.fixture
def many(made_once: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made_once, tmp_path / "run")


@pytest.mark.slow
def test_the_data_are_those_of_the_leaderboard(many: Path, full_run: Path) -> None:
    found = report_data([many])
    (board,) = found["boards"]
    rows = {row["method"]: row for row in board["views"][0]["rows"]}
    assert [view["label"] for view in board["views"]] == [
        "all samples", "circle", "ring", "two-circles",
    ]  # fmt: skip
    assert rows["poor"]["group"] not in (rows["good"]["group"], rows["as-good"]["group"])
    assert rows["good"]["command"] == (
        "eitbench run bench.toml --scenarios conductivity-set --methods good"
    )
    assert f"'{NASTY}'" in rows[NASTY]["command"]
    assert board["clusters"] == 24
    assert len(board["sensitivity"]) == 6
    assert found["missing"] == []
    json.dumps(found, allow_nan=False)
    assert len(report_data([full_run])["boards"]) == 4


def test_a_scenario_that_nothing_ranks_is_reported(
    build: Any, dataset_of: Any, tmp_path: Path
) -> None:
    """Frames whose truth is not known, and none of which is repeated."""
    data = dataset_of("none", 4)
    data.samples["touched"] = True
    build.add_scaled(data, {"good": 0.9})
    run = build.write()
    names = {path.name for path in write_report([run], tmp_path / "report")[0]}
    assert "index.html" in names
    assert not any(name.startswith("frontier") for name in names)
    assert "no method has a figure to rank by" in (tmp_path / "report/index.html").read_text()


def test_the_answer_names_ties_and_the_fastest(many: Path) -> None:
    (board,) = report_data([many])["boards"]
    said = answer(board)
    first, second = (row["method"] for row in board["views"][0]["rows"][:2])
    assert said.startswith("On bench / conductivity-set (24 samples), ")
    assert f"{first} is first with S " in said
    assert f"but cannot be told apart from {second}; the fastest of them is good (0.5 ms" in said


def test_the_answer_says_how_far_ahead_the_best_is(build: Any, dataset_of: Any) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.5})
    (board,) = report_data([build.write()])["boards"]
    said = answer(board)
    assert re.search(r"good is the best: S [\d.]+ \(95 %: [\d.]+ to [\d.]+\)\.", said)
    assert re.search(r"ahead of poor by [\d.]+ \([\d.]+ to [\d.]+; p < 0.001\)\.", said)
    # Ranks of paired differences may tell two medians apart whose interval holds 0.
    board["pairs"][0] |= {"difference": 0.21, "low": -0.28, "high": 0.56}
    assert "ahead of poor by 0.210 (-0.280 to 0.560; p < 0.001)." in answer(board)


@pytest.mark.slow
def test_many_answers_begin_with_how_often_each_method_is_among_the_best(
    build: Any, dataset_of: Any, made_once: Path
) -> None:
    for k in range(7):
        shares = {"a": 0.9, "b": 0.5, "c": 0.4} if k < 4 else {"a": 0.5, "b": 0.9, "c": 0.4}
        build.add_scaled(dataset_of("conductivity", 12, f"s{k}"), shares)
    found = report_data([build.write()])
    said = (
        "First, or not to be told apart from the first, of the scenarios that each method ran on: "
    )
    assert summary(found["boards"]) == [f"{said}a on 4 of 7 and b on 3 of 7."]
    page = to_page(found)
    assert page.index(said) < page.index("<details") < page.index("On bench / s0")
    few = report_data([made_once])
    (tied,) = summary(few["boards"])
    assert tied == f"{said}as-good on 1 of 1 and good on 1 of 1."
    assert tied not in to_page(few)


@pytest.mark.slow
def test_the_report_of_many_samples_is_that_of_few_made_by_two_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = Path(__file__).parents[3] / "reports" / "board" / "2026.2" / "quick"
    written, _ = write_report([record], tmp_path / "one")
    monkeypatch.setattr("eitbench.reports.page.report.MANY_SAMPLES", 0)
    again, _ = write_report([record], tmp_path / "two")
    names = [path.relative_to(tmp_path / "one") for path in written]
    assert [path.relative_to(tmp_path / "two") for path in again] == names
    assert any(name.stem == "uncertainty" for name in names)
    for name in names:
        if name.suffix in (".md", ".csv", ".tex", ".html", ".svg"):
            one, two = ((tmp_path / each / name).read_bytes() for each in ("one", "two"))
            assert one == two, name


TRAINED = {
    "model": False, "conductivity_range": True, "noise": [], "tuned": {}, "given": [],
    "trained_on": {"train_samples": 24000, "seed": "0"}, "families": "same",
}  # fmt: skip


@pytest.fixture(scope="module")
def several_once(
    tmp_path_factory: pytest.TempPathFactory, run_builder: Any, dataset_of: Any
) -> Path:
    """Two scenarios of one sensor and two of another, on which "net" is the worst."""
    build = run_builder(tmp_path_factory.mktemp("several") / "run")
    for k in range(4):
        shares = {"net": 0.95 if k < 2 else 0.3, "fair": 0.8, "slow": 0.6}
        build.add_scaled(dataset_of("conductivity", 12, f"s{k}"), shares, noise=0.01)
    folder: Path = build.write()
    cells = pd.read_parquet(folder / "methods.parquet")
    untrained = TRAINED | {"model": True, "trained_on": {}, "families": None}
    told = {
        "net": json.dumps(TRAINED),
        "fair": json.dumps(untrained),
        "slow": json.dumps(untrained),
    }
    cells["prior_knowledge"] = cells["method"].map(told)
    cells["frame_ms_p50"] = cells["method"].map({"net": 1.0, "fair": 2.0, "slow": 50.0})
    cells.to_parquet(folder / "methods.parquet")
    with edited_manifest(folder) as content:
        for k, data in enumerate(content["data"].values()):
            data["sensor"] = "foam16" if k < 2 else "skin"
        content["plan"]["suite"]["scenarios"] = [{"kind": "recorded", "name": "s3"}]
    return folder


@pytest.mark.slow
def test_the_answer_says_what_ranks_what_was_trained_and_where_the_best_loses(
    several_once: Path,
) -> None:
    boards = report_data([several_once])["boards"]
    said = answer(boards[0], boards)
    assert "net is the best" in said
    assert "PSNR has 93 % of the weight in S." in said
    assert (
        "net needs training data: weights trained once with seed 0 on 24,000 samples; trained "
        "on the families of the test phantoms." in said
    )
    assert said.endswith(
        "Elsewhere it loses: 3rd of 3 on bench / s2 and 3rd of 3 on bench / s3 (a real sensor)."
    )
    said = answer(boards[2], boards)
    assert "fair needs no training data. Elsewhere it loses: 2nd of 3 on bench / s0" in said
    assert "Elsewhere" not in answer(boards[2], boards[2:])


@pytest.mark.slow
def test_scenarios_are_summed_up_under_each_filter(several_once: Path) -> None:
    views = report_data([several_once])["overall"]

    def ranks(key: str) -> dict[str, float]:
        return {row["method"]: row["rank"] for row in views[key]["rows"]}

    assert ranks("||") == {"fair": 1.5, "net": 2.0, "slow": 2.5}
    assert {row["method"]: row["wins"] for row in views["||"]["rows"]} == {
        "fair": 0.5, "net": 0.5, "slow": 0.0,
    }  # fmt: skip
    assert ranks("||foam16") == {"net": 1.0, "fair": 2.0, "slow": 3.0}
    assert ranks("untrained||") == {"fair": 1.0, "slow": 2.0}
    assert ranks("|fast|skin") == {"fair": 1.0, "net": 2.0}
    assert "untrained|fast|" not in views  # one method alone
    boards = report_data([several_once])["boards"]
    smaller = boards[0] | {"n": 6, "views": [{**boards[0]["views"][0], "rows": []}]}
    assert overall_views([*boards, smaller]) == overall_views([smaller, *boards]) == views


@pytest.fixture
def two_sizes(run_builder: Any, dataset_of: Any, tmp_path: Path) -> list[Path]:
    """Two runs of one suite and scenarios on other data: 12 samples, and 18."""
    runs = []
    for n in (12, 18):
        build = run_builder(tmp_path / f"n{n}")
        for k in range(2):
            shares = {"good": 0.9, "poor": 0.5} if n == 18 else {"good": 0.9, "early": 0.7}
            build.add_scaled(dataset_of("conductivity", n, f"s{k}"), shares, noise=0.01)
        runs.append(build.write())
        with edited_manifest(runs[-1]) as content:
            for data in content["data"].values():
                data["hash"] = f"{n}abcdef"
            content["versions"] = {"eitbench": "0.1.0"}
    return runs


@pytest.mark.slow
def test_boards_of_other_data_have_other_names_and_figures(two_sizes: list[Path]) -> None:
    found = report_data(two_sizes)
    names = [board["name"] for board in found["boards"]]
    assert {"bench / s0 (n = 12, data 12abcd)", "bench / s0 (n = 18, data 18abcd)"} <= set(names)
    stems = [stem for stem, _ in paper_figures(found["boards"])]
    assert "frontier-bench-s0-n-12-data-12abcd" in stems
    assert len(set(stems)) == len(stems) == 2 * len(names)
    said = [answer(board) for board in found["boards"]]
    assert all(text.startswith(f"On {name}, ") for text, name in zip(said, names, strict=True))
    assert report_data(two_sizes[:1])["boards"][0]["name"] == "bench / s0"


@pytest.mark.slow
def test_the_data_that_count_over_all_scenarios_are_named(
    two_sizes: list[Path], several_once: Path, tmp_path: Path
) -> None:
    found = report_data(two_sizes)
    view = found["overall"]["||"]
    assert view["scenarios"] == [f"bench / s{k} (n = 18, data 18abcd)" for k in range(2)]
    assert "early" not in {row["method"] for row in view["rows"]}
    said = counted_data(found["boards"])
    assert ", ".join(view["scenarios"]) in said
    assert said in to_page(found)
    write_site(two_sizes[0].parent, tmp_path / "site")
    assert said in (tmp_path / "site" / "suites" / "bench.html").read_text()
    assert counted_data(report_data([several_once])["boards"]) == ""


@pytest.mark.slow
def test_a_loss_is_significant_and_a_single_method_is_not_first(
    build: Any, dataset_of: Any
) -> None:
    build.add_scaled(dataset_of("conductivity", 12, "s0"), {"good": 0.9, "poor": 0.5}, noise=0.01)
    build.add_scaled(dataset_of("conductivity", 3, "s1"), {"good": 0.5, "poor": 0.9}, noise=0.01)
    build.add_scaled(dataset_of("conductivity", 12, "s2"), {"good": 0.9})
    boards = report_data([build.write()])["boards"]
    assert boards[1]["pairs"] == []
    assert "Elsewhere" not in answer(boards[0], boards)
    alone = answer(boards[2], boards)
    assert alone.startswith("On bench / s2 (12 samples), only good was run: S ")


def test_code_on_another_drive_has_no_link(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def no_way(*_: object) -> str:
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    monkeypatch.setattr(report, "plugin_copies", lambda _: ["plugins/c0de.py"])
    run = SimpleNamespace(path=tmp_path / "run")
    assert list(report._code_links([run], tmp_path)) == ["plugins/c0de.py in the run run"]  # type: ignore[list-item]
    monkeypatch.setattr("os.path.relpath", no_way)
    assert report._code_links([run], tmp_path) == {}  # type: ignore[list-item]


@pytest.mark.slow
def test_methods_are_shown_with_what_they_were_told_source_and_code(
    several_once: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(several_once, tmp_path / "run")
    (run / "reconstructions.h5").unlink()
    digest = "c0de" * 16
    (run / "plugins").mkdir()
    (run / "plugins" / f"{digest[:16]}.py").write_text("")
    for name in ("samples", "methods"):
        table = pd.read_parquet(run / f"{name}.parquet")
        table["method"] = table["method"].replace("slow", "noser")
        table = table[table["scenario"].isin(["s0", "s2"])]
        table.to_parquet(run / f"{name}.parquet")
    with edited_manifest(run) as content:
        content["plan"]["plugins"] = [{"path": "x.py", "sha256": digest, "names": ["fair"]}]
        content["git_commit"] = "0123456789abcdef"
    write_report([run], tmp_path / "out")
    write_report([run], tmp_path / "out")  # which replaces its own page
    with pytest.raises(InputError, match="is a run directory, which holds what a run writes alone"):
        write_report([run], run)
    (tmp_path / "mine").mkdir()
    mine = tmp_path / "mine" / "index.html"
    mine.write_text("<title>My page</title>")
    with pytest.raises(InputError, match=r"index\.html is no page of eitbench"):
        write_report([run], mine.parent)
    assert mine.read_text() == "<title>My page</title>"
    assert list(mine.parent.iterdir()) == [mine]
    paper = tmp_path / "paper"
    paper.mkdir()
    (paper / "references.bib").write_text("@article{mine}")
    with pytest.raises(InputError, match=r"holds files of others, such as references\.bib"):
        write_report([run], paper)
    assert [path.read_text() for path in paper.iterdir()] == ["@article{mine}"]
    page = (tmp_path / "out" / "index.html").read_text()
    (table,) = re.findall(r'aria-label="Methods">.*?</table>', page, re.DOTALL)
    rows = dict(re.findall(r'<th scope="row">([^<]+)</th>(.*?)</tr>', table, re.DOTALL))
    assert "weights trained once with seed 0 on 24,000 samples" in rows["net"]
    assert "an installed package" in rows["net"]
    assert f'href="../run/plugins/{digest[:16]}.py"' in rows["fair"]
    assert "Cheney et al., NOSER: An algorithm" in rows["noser"]
    assert "methods/classical/noser.py of eitbench commit 0123456789" in rows["noser"]
    assert (tmp_path / "out" / "figures" / "critical-difference.pdf").is_file()
    assert 'id="critical-difference" src="data:image/png' in page


def test_a_refused_or_stopped_report_keeps_the_one_that_is_there(
    build: Any, dataset_of: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"good": 0.9, "poor": 0.2})
    run, out, new = build.write(), tmp_path / "out", tmp_path / "new"
    with pytest.raises(InputError, match="is given twice"):
        write_report([run, run], new)
    assert not new.exists()
    out.mkdir()
    with pytest.raises(InputError, match="is given twice"):
        write_report([run, run], out)
    assert list(out.iterdir()) == []
    write_report([run], out)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="is given twice"):
        write_report([run, run], out)

    def refused(*_: object) -> None:
        raise InputError("It cannot be told.")

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    late = tmp_path / "late"
    monkeypatch.setattr("eitbench.reports.page.report.findings", refused)
    with pytest.raises(InputError, match="cannot be told"):
        write_report([run], late)
    assert len([*late.iterdir()]) > 1
    report.check_own_folder(late)
    monkeypatch.setattr("eitbench.reports.page.report.report_of", stopped)
    for folder in (out, new):
        with pytest.raises(KeyboardInterrupt):
            write_report([run], folder)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert "Not finished" in (new / "index.html").read_text()
    report.check_own_folder(new)  # the next report may go there


def test_names_are_data_in_the_page(many: Path) -> None:
    page = to_page(report_data([many]))
    assert "<img" not in page
    data = re.search(r'<script type="text/plain" id="data">([A-Za-z0-9+/=]*)</script>', page)
    assert data is not None
    content = json.loads(zlib.decompress(base64.b64decode(data[1])))
    names = {row["method"] for row in content["boards"][0]["views"][0]["rows"]}
    assert NASTY in names


def test_a_page_that_would_be_large_leaves_out_families_and_says_so(
    full_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = "it shows only the first 1 of up to"
    assert said not in to_page(report_data([full_run]))
    monkeypatch.setattr("eitbench.reports.page.images.IMAGES", 1)
    report = report_data([full_run])
    assert said in to_page(report)
    shown = [board["images"] for board in report["boards"] if board["images"]]
    assert all(len({case["family"] for case in images["cases"]}) == 1 for images in shown)


def test_the_page_needs_nothing_else(many: Path) -> None:
    page = to_page(report_data([many]))
    head = page[: page.index('id="plotly"')]
    assert not re.search(r"(?:src|href)\s*=\s*[\"'](?!#)", head)
    assert "default-src 'none'" in head
    assert len(page) < 5e6


@pytest.mark.slow
def test_files_for_a_paper(many: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    written = {str(path.relative_to(out)) for path in write_report([many], out)[0]}
    frontier, grid = (
        f"figures/{kind}-bench-conductivity-set" for kind in ("frontier", "comparison")
    )
    assert written == {
        "index.html", f"{frontier}.pdf", f"{frontier}.svg", "references.bib",
        f"{grid}.pdf", f"{grid}.svg",
        "tables/leaderboard.csv", "tables/leaderboard.md", "tables/leaderboard.tex",
    }  # fmt: skip
    for name in (frontier, grid):
        pdf = (out / f"{name}.pdf").read_bytes()
        assert b"/FontFile2" in pdf  # embedded TrueType
        assert b"/Type3" not in pdf
        # 3.5 in, the width of IEEE's column.
        box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+)", pdf)
        assert box is not None
        assert float(box[1]) == pytest.approx(3.5 * 72)
    table = pd.read_csv(out / "tables" / "leaderboard.csv")
    assert set(table["method"]) == {"good", "as-good", "poor", NASTY}
    assert "command" not in table
    again = tmp_path / "again"
    write_report([many], again)
    for name in (f"{frontier}.pdf", f"{frontier}.svg", "tables/leaderboard.tex"):
        assert (again / name).read_bytes() == (out / name).read_bytes()


@pytest.mark.slow
def test_no_text_of_a_figure_is_cut(many: Path) -> None:
    (board,) = report_data([many])["boards"]
    rows = board["views"][0]["rows"]
    rows += [rows[0] | {"method": f"a-rather-long-name-{k}"} for k in range(12)]
    levels = [board | {"snr_db": level} for level in (30.0, 50.0, "clean")]
    with mpl.rc_context(STYLE):
        figures = (frontier(board), noise(levels))
        for figure in figures:
            figure.draw_without_rendering()
    for figure in figures:
        (axes,), (legend,) = figure.axes, figure.legends
        for text in (*legend.get_texts(), axes.xaxis.label, axes.yaxis.label):
            box = text.get_window_extent()
            assert figure.bbox.x0 <= box.x0, text.get_text()
            assert box.x1 <= figure.bbox.x1, text.get_text()


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["conductivity-set", "position-set"])
def test_a_comparison_holds_all_methods_and_is_legible_in_a_column(
    full_run: Path, scenario: str
) -> None:
    board = next(b for b in report_data([full_run])["boards"] if b["scenario"] == scenario)
    images = board["images"]
    assert images is not None
    with mpl.rc_context(STYLE):
        figure = comparison(images)
        figure.draw_without_rendering()
    assert figure.get_figwidth() == 3.5
    *grid, scale = figure.axes
    titles = [axes.title for axes in grid if axes.get_title()]
    assert [title.get_text().strip() for title in titles] == images["names"]
    for text in (*titles, scale.xaxis.label, *scale.get_xticklabels()):
        assert float(text.get_fontsize()) >= 6
        box = text.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    low, high = scale.get_xlim()
    assert (low == pytest.approx(-high)) == (scenario == "position-set")  # contrast


@pytest.mark.parametrize(("families", "steps"), [(6, STEPS), (1, FEW_STEPS)])
def test_packed_images_are_those_of_the_run(full_run: Path, families: int, steps: int) -> None:
    run = read_run(full_run)
    images = packed_images({"sharp": (run, "sharp")}, "conductivity-set", "score", families)
    assert images is not None
    assert (images["steps"], len({case["family"] for case in images["cases"]})) == (
        steps,
        min(families, images["families"]),
    )
    stored = run.estimates("conductivity-set", "sharp", images["samples"])
    step = (images["high"] - images["low"]) / steps
    found = unpacked(images)[images["names"].index("sharp")]
    inside = ~np.isnan(found)
    assert inside.any()
    assert stored is not None
    clipped = np.clip(stored, images["low"], images["high"])
    assert np.abs(found - clipped)[inside].max() <= 0.51 * step


def test_images_have_the_figure_that_ranks_them(full_run: Path) -> None:
    run = read_run(full_run)
    images = packed_images({"sharp": (run, "sharp")}, "conductivity-set", "rie")
    assert images is not None
    figures = images["figures"]["sharp"]
    assert all("rie" in of for of in figures if of["status"] == "ok")
    board: Any = {"images": images, "ranked_by": "rie"}
    best, worst = extremes(board, "sharp") or (0, 0)
    assert figures[best]["rie"] < figures[worst]["rie"]  # the smaller the better


def test_the_best_values_are_those_of_the_tables(full_run: Path) -> None:
    """Of rows with all samples, and with an image of some, whatever the others have."""
    (board, *_) = report_data([full_run])["boards"]
    rows = board["views"][0]["rows"]
    failed = rows[0] | {"method": "failed", "label": "failed", "coverage": 0.0, "setup_s": 1e-9}
    part = rows[0] | {"method": "part", "label": "part", "n": 1, "score": 99.0}
    board["views"][0]["rows"] = [*rows, failed, part]
    shown = report._for_script(board)["views"][0]["rows"]
    best = {row["label"]: row["best"] for row in shown}
    assert best["failed"] == best["part"] == []
    assert any("score" in names for names in best.values())


def test_the_frontier_joins_what_no_other_method_beats(many: Path) -> None:
    assert fastest_for_quality([(3, 1), (1, 5), (2, 5), (2, 4), (4, 2)]) == [1, 3, 0]
    (board,) = report_data([many])["boards"]
    (axes,) = frontier(board).axes
    line = next(line for line in axes.lines if str(line.get_label()).startswith("no method beats"))
    rows = board["views"][0]["rows"]
    costs = [(row["frame_ms_p50"], -row["score"]) for row in rows]
    assert np.asarray(line.get_xdata()).tolist() == [
        costs[k][0] for k in fastest_for_quality(costs)
    ]


@pytest.mark.slow
def test_boards_of_one_noise_level_have_no_figure_against_noise(many: Path) -> None:
    (board,) = report_data([many])["boards"]
    at = {level: board | {"snr_db": level} for level in (50.0, 30.0)}

    def stems(boards: list[Any]) -> list[str]:
        return [stem for stem, _ in paper_figures(boards) if stem.startswith("noise")]

    assert stems([at[50.0], at[50.0]]) == []
    assert stems([at[50.0], at[30.0]]) == ["noise-bench"]


DOCUMENT = r"""\documentclass[twocolumn]{article}
\usepackage[textwidth=7.16in]{geometry}
\usepackage{booktabs}
\begin{document}
\input{tables/leaderboard}
\nocite{*}
\bibliographystyle{plain}
\bibliography{references}
\end{document}
"""


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="needs LaTeX: install the program `pdflatex`"
)
def test_the_tables_compile_and_fit_the_page(many: Path, full_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    write_report([many, full_run], out)
    (out / "paper.tex").write_text(DOCUMENT)
    for program in (["pdflatex", "-interaction=nonstopmode", "-halt-on-error"], ["bibtex"]):
        done = subprocess.run(
            [*program, "paper"], cwd=out, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout
        assert not re.search("Overfull|Warning--", done.stdout), done.stdout


def test_published_claims_stand_in_the_report_of_the_paper_s_suite(build: Any, paper: Any) -> None:
    build.suite = "paper"
    build.add_scaled(paper, {"dnn": 1.0, "phydnn": 1.0})
    found = report_data([build.write()])
    verdicts = {claim["claim"]: claim["verdict"] for claim in found["claims"]}
    assert verdicts["The networks reconstruct 10 frames per second."] == "holds"
    assert "The networks reconstruct 10 frames per second." in to_page(found)


# ---- bad input ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_without_images_the_rest_is_shown(many: Path, tmp_path: Path) -> None:
    (many / "reconstructions.h5").unlink()
    found = report_data([many])
    assert found["boards"][0]["images"] is None
    assert found["boards"][0]["sensitivity"] == []
    (missing,) = found["missing"]
    assert "reconstructions.h5" in missing
    assert missing in to_page(found)
    done = CliRunner().invoke(results, ["report", str(many), "--out", str(tmp_path / "report")])
    assert done.exit_code == 0
    assert len(done.stdout.splitlines()) == 7  # files
    assert done.stderr.strip() == f"eitbench: {missing}"


def test_boards_of_many_scenarios_have_one_view_and_no_other_metrics(
    build: Any, dataset_of: Any
) -> None:
    """Each has both in a report of fewer: they would take minutes."""
    for k in range(MOST_SINGLE + 1):
        build.add_scaled(dataset_of("conductivity", 6, f"of-{k}"), {"good": 0.9, "poor": 0.2})
    path = build.write()
    many = report_data([path])["boards"]
    assert len(many) == MOST_SINGLE + 1
    assert all(len(board["views"]) == 1 and not board["sensitivity"] for board in many)
    run = read_run(path)
    first = replace(run, samples=run.samples[run.samples["scenario"] == "of-0"])
    (alone,) = report_of([first])["boards"]
    assert len(alone["views"]) > 1
    assert alone["sensitivity"]


def test_an_unfinished_run_says_so(many: Path) -> None:
    with edited_manifest(many) as content:
        content["status"] = "interrupted"
    table = pd.read_parquet(many / "samples.parquet")
    table[(table["method"] != "poor") | (table["sample"] < 5)].to_parquet(many / "samples.parquet")
    found = report_data([many])
    (missing,) = found["missing"]
    assert "interrupted" in missing
    rows = {row["method"]: row for row in found["boards"][0]["views"][0]["rows"]}
    assert rows["poor"]["group"] is None
    assert rows["good"]["group"] is not None
    assert rows["poor"]["rank"] == 4  # below those that have all samples, however good its few
    to_page(found)


@pytest.mark.slow
def test_several_runs_are_shown_alike(many: Path, tmp_path: Path) -> None:
    """The same methods in two runs, on unlike machines: each with its images, figures and name."""
    other = shutil.copytree(many, tmp_path / "other")
    table = pd.read_parquet(other / "samples.parquet")
    table.assign(rie=table["rie"] / 2).to_parquet(other / "samples.parquet")
    for run, machine, solve in ((other, "Another", 10.0), (many, "One", 20.0)):
        cells = pd.read_parquet(run / "methods.parquet")
        cells.assign(machine=machine, calibration_ms=solve).to_parquet(run / "methods.parquet")
    (board,) = report_data([many, other])["boards"]
    rows = {row["label"]: row for row in board["views"][0]["rows"]}
    assert {"good (run)", "good (other)", "poor (run)", "poor (other)"} <= set(rows)
    assert board["images"] is not None
    assert set(board["images"]["names"]) == {"truth", *rows}
    assert set(board["sensitivity"][0]["score"]) == set(rows)
    assert rows["poor (other)"]["anchored"][2] > rows["poor (run)"]["anchored"][2]
    assert rows["poor (other)"]["anchored"][0] == rows["poor (run)"]["anchored"][0]
    said = answer(board)
    assert "calibration solves a frame)" in said
    assert " ms " not in said


def test_the_first_is_tied_with_all_that_differ_by_chance(many: Path) -> None:
    """A noisy method may be further down than one that is surely worse."""
    (board,) = report_data([many])["boards"]
    names = [row["label"] for row in board["views"][0]["rows"]]
    for pair in board["pairs"]:
        if pair["first"] == 0:
            pair["p"] = 1.0 if pair["second"] == 2 else 1e-4
    assert f"cannot be told apart from {names[2]};" in answer(board)


@pytest.mark.parametrize("column", ["psnr", "cluster", "status"])
def test_a_column_that_is_missing_is_one_sentence(many: Path, column: str) -> None:
    table = pd.read_parquet(many / "samples.parquet")
    table.drop(columns=column).to_parquet(many / "samples.parquet")
    with pytest.raises(DataCorruptError, match=f"no column '{column}': run the suite again"):
        report_data([many])


def test_a_damaged_table_is_refused_with_one_sentence(many: Path, tmp_path: Path) -> None:
    (many / "samples.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(DataCorruptError, match=r"samples\.parquet"):
        write_report([many], tmp_path / "report")
    assert not (tmp_path / "report").exists()
    with pytest.raises(InputError):
        report_data([tmp_path])


@pytest.mark.slow
def test_operators_get_a_board_and_tables_beside_methods(
    many: Path, build_operators: Any, tmp_path: Path
) -> None:
    runs = [many, build_operators({"surrogate": 0.1, "jacobian": 0.4})]
    found = report_data(runs)
    assert [board["kind"] for board in found["boards"]] == ["method", "operator"]
    assert answer(found["boards"][1]).endswith("surrogate is first: MSE 0.1.")
    write_report(runs, tmp_path / "report")
    tables = {path.name for path in (tmp_path / "report" / "tables").iterdir()}
    assert {"leaderboard.csv", "operators.csv", "operators.tex"} <= tables


def test_a_run_without_rows_is_refused(many: Path) -> None:
    pd.read_parquet(many / "samples.parquet")[:0].to_parquet(many / "samples.parquet")
    with pytest.raises(InputError, match="no results"):
        report_data([many])


def test_boards_of_methods_and_of_operators_have_names_of_their_own() -> None:
    boards: Any = [
        {"name": name, "kind": kind}
        for name, kind in (("a / b", "method"), ("a / b", "operator"), ("a / c", "method"))
    ]
    name_kinds(boards)
    assert [board["name"] for board in boards] == ["a / b (methods)", "a / b (operators)", "a / c"]
