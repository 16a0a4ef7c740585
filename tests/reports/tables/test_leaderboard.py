import csv
import html
import io
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest
from tests.support.reports import report_data

from eitbench.benchmark.metrics.metric_spec import SMALL, TIME
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.reports.page.paper import write_paper
from eitbench.reports.tables.boards import note, notes, printed_boards
from eitbench.reports.tables.columns import METHOD_LAYOUT as LAYOUT
from eitbench.reports.tables.columns import Column
from eitbench.reports.tables.leaderboard import FORMATS, chosen_columns, ranked_rows, sorted_rows
from eitbench.reports.tables.references import entries
from eitbench.scenarios.errors import DataCorruptError, InputError

NASTY = "a|b_<img src=x>$\\%&`\x1b[31m\nend"
CONTRACT = {
    "suite", "scenario", "method", "track", "n", "coverage", "ssim", "cc", "rie", "psnr", "score",
    "rank", "localisation_mm", "frame_ms_p50", "frame_ms_p99", "setup_s", "train_s",
}  # fmt: skip


@pytest.fixture
def nasty(build: Any, dataset_of: Any) -> list[dict[str, Any]]:
    build.add_scaled(dataset_of("conductivity", 4), {NASTY: 1.0, "plain": 0.5})
    return ranked_rows([build.write()])


@pytest.fixture
def many_rows(build: Any, dataset_of: Any) -> list[dict[str, Any]]:
    shares = {"gauss-newton-noser": 0.9, "as-good": 0.9, "poor": 0.5}
    build.add_scaled(dataset_of("conductivity", 12), shares, noise=0.02)
    return ranked_rows([build.write()])


def test_rows_hold_the_contract_and_full_precision(full_run: Path) -> None:
    rows = ranked_rows([full_run])
    assert len(rows) == 12
    assert all(set(row) >= CONTRACT for row in rows)
    assert json.loads(FORMATS["json"](rows)) == rows
    read = list(csv.DictReader(io.StringIO(FORMATS["csv"](rows))))
    for row, line in zip(rows, read, strict=True):
        for name in ("score", "localisation_mm", "frame_ms_p50"):
            assert (line[name] == "") if row[name] is None else (float(line[name]) == row[name])


@pytest.mark.slow
@pytest.mark.parametrize("start", ["=", "+", "-", "@", "\t", "\r"])
def test_a_name_is_no_formula_of_a_spreadsheet(full_run: Path, start: str) -> None:
    """An apostrophe before it, as OWASP advises; numbers stay numbers."""
    rows = [row | {"method": f"{start}HYPERLINK(1)"} for row in ranked_rows([full_run])]
    rows[0]["score"] = -0.5
    lines = list(csv.DictReader(io.StringIO(FORMATS["csv"](rows), newline="")))
    assert {line["method"] for line in lines} == {f"'{start}HYPERLINK(1)".replace("\r", "\n")}
    assert lines[0]["score"] == "-0.5"


def test_an_empty_leaderboard_prints_in_every_format() -> None:
    assert json.loads(FORMATS["json"]([])) == []
    assert all(FORMATS[form]([]) == "" for form in ("csv", "md", "latex", "html"))


def test_columns_are_chosen_and_rows_sorted_in_every_format(full_run: Path) -> None:
    rows = ranked_rows([full_run])
    columns = chosen_columns(rows, ["ssim", "frame_ms_p99"])
    assert columns == ["method", "ssim", "frame_ms_p99"]
    by_ssim = sorted_rows(rows, "ssim")
    scenario = [row for row in by_ssim if row["scenario"] == rows[0]["scenario"]]
    known = [row["ssim"] for row in scenario if row["ssim"] is not None]
    assert known == sorted(known, reverse=True)
    quick = [row["frame_ms_p50"] for row in sorted_rows(scenario, "frame_ms_p50")]
    assert quick == sorted(quick, key=lambda ms: (ms is None, ms))
    head = "| Method | SSIM | p99 \\[ms\\] |"
    assert FORMATS["md"](by_ssim, columns).count(head) == len({r["scenario"] for r in rows})
    assert "Method & SSIM $\\uparrow$ & p99 [ms] $\\downarrow$ \\\\" in FORMATS["latex"](
        by_ssim, columns
    )
    assert FORMATS["csv"](by_ssim, columns).startswith("suite,scenario,method,ssim,frame_ms_p99\n")
    printed = ["METHOD", "b", "Loc.", "loc. mm", "Ties", "p99 [ms]", "Frame", "S"]
    assert chosen_columns(rows, printed) == [
        "method", "bounded", "localisation_mm", "group", "frame_ms_p99", "frame_ms_p50", "score",
    ]  # fmt: skip
    assert sorted_rows(rows, "frame ms") == sorted_rows(rows, "frame_ms_p50")
    last = {row["scenario"]: k for k, row in enumerate(rows)}  # a text in the last rows alone
    texts = [row | {"group": "a" if k in last.values() else ""} for k, row in enumerate(rows)]
    firsts = {row["scenario"]: row["group"] for row in reversed(sorted_rows(texts, "group"))}
    assert set(firsts.values()) == {"a"}
    with pytest.raises(InputError, match="Unknown column 'scroe': did you mean 'score'"):
        sorted_rows(rows, "scroe")
    with pytest.raises(InputError, match="Unknown column 'scroe'"):
        chosen_columns(rows, ["rank", "scroe"])


def test_markdown_shows_one_table_per_scenario_with_the_best_in_bold(full_run: Path) -> None:
    text = FORMATS["md"](ranked_rows([full_run]))
    assert text.count("### ") == 4
    tables = dict(part.split("\n", 1) for part in text.split("### ")[1:])
    simulated, pressed, *_ = tables
    assert simulated == "bench / conductivity-set: sensor foam16, SNR 50 dB, 8 test samples"
    assert pressed == "bench / position-set: sensor disc, 8 test samples"
    assert "SSIM" in tables[simulated]
    assert "SSIM" not in tables[pressed]
    assert "Training" not in text
    assert "Run" not in text
    best = min(
        (r for r in ranked_rows([full_run]) if r["scenario"] == "position-set"),
        key=lambda row: float(row["localisation_mm"]),
    )
    line = next(x for x in tables[pressed].splitlines() if best["method"] in x)
    assert f"**{best['localisation_mm']:.1f}**" in line


def test_a_note_tells_the_noise_of_frame_and_touch_and_shared_times(
    build: Any, dataset_of: Callable[..., Any]
) -> None:
    made = dataset_of("conductivity", 12, scenario="noisy")
    made.samples["snr_db"], made.samples["touch_snr_db"] = 40.0, np.arange(12.0)
    build.add_scaled(made, {"one": 0.5, "other": 0.4})
    build.methods[0]["timed"], build.methods[1]["timed"] = "pinned", "shared"
    text = FORMATS["md"](ranked_rows([build.write()]))
    assert "SNR 40 dB of the frame, 6 dB of its change by the touch (medians)" in text
    assert "times of 1 of 2 rows were measured while other cells ran" in text


def test_names_are_data_in_markdown(nasty: list[dict[str, Any]]) -> None:
    text = FORMATS["md"](nasty)
    assert "<img" not in text
    assert "&lt;img" in text
    assert "\x1b" not in text
    rows = [line for line in text.splitlines() if line.startswith("|")]
    cells = {line.replace("\\|", "").count("|") for line in rows}
    assert len(rows) == 4
    assert len(cells) == 1


def test_names_are_data_in_latex(nasty: list[dict[str, Any]]) -> None:
    text = FORMATS["latex"](nasty)
    line = next(x for x in text.splitlines() if "img" in x)
    name = line.split(" & ")[1]
    assert name.startswith(r"a\textbar{}b\_\textless{}img")
    assert r"\$\textbackslash{}\%\&" in name
    for rule in ("\\toprule", "\\midrule", "\\bottomrule", "\\usepackage{booktabs}"):
        assert rule in text


def test_names_are_data_in_html_csv_and_json(nasty: list[dict[str, Any]]) -> None:
    assert "<img" not in FORMATS["html"](nasty)
    assert "&lt;img" in FORMATS["html"](nasty)
    read = list(csv.DictReader(io.StringIO(FORMATS["csv"](nasty), newline="")))
    assert read[0]["method"] == NASTY
    assert json.loads(FORMATS["json"](nasty))[0]["method"] == NASTY


def test_the_terminal_shows_names_as_they_are_and_no_markup(
    nasty: list[dict[str, Any]], printed: Callable[..., str]
) -> None:
    nasty[1]["method"] = "[bold]odd[/bold]"
    text = printed(nasty, "terminal")
    assert "[bold]odd[/bold]" in text
    assert "\x1b" not in text
    assert "bench / conductivity-set" in text
    assert "SSIM" in text


@pytest.mark.parametrize("width", [60, 80, 100, 150])
def test_a_narrow_terminal_shows_fewer_columns_but_whole_ones(
    nasty: list[dict[str, Any]], width: int, printed: Callable[..., str]
) -> None:
    nasty[0]["method"] = "gauss-newton-noser"
    text = printed(nasty, "terminal", width)
    assert max(map(len, text.splitlines())) <= width
    assert "gauss-newton-noser" in text
    assert format(nasty[0]["score"], ".3f") in text


def test_nothing_is_highlighted_where_all_are_equal(nasty: list[dict[str, Any]]) -> None:
    for row in nasty:
        row["iou"] = 0.5
        row["cc"] = 0.25 if row["method"] == "plain" else 0.75
    line = next(x for x in FORMATS["md"](nasty).splitlines() if "plain" in x)
    assert "**0.500**" not in line
    assert "0.250" in line
    assert "**0.750**" in FORMATS["md"](nasty)


def test_more_is_not_better_of_a_figure_that_should_be_one(nasty: list[dict[str, Any]]) -> None:
    for row in nasty:
        row["edge"] = 1.47 if row["method"] == "plain" else 0.98
    text = FORMATS["md"](nasty, ("method", "edge"))
    assert "1.47" in text
    assert "**" not in text


def test_a_mean_over_the_first_samples_is_not_the_best(build: Any, dataset_of: Any) -> None:
    build.add_scaled(dataset_of("conductivity", 24), {"good": 0.9, "poor": 0.5}, noise=0.02)
    rows = ranked_rows([build.write()])
    best = next(row for row in rows if row["method"] == "good")
    assert "**" in next(x for x in FORMATS["md"](rows).splitlines() if " good " in x)
    best["n"] = 12
    lines = FORMATS["md"](rows).splitlines()
    assert "**" not in next(x for x in lines if " good " in x)
    assert "good has 12 of 24 samples and ranks below those that have all" in " ".join(lines)


def test_unlike_data_get_tables_of_their_own(full_run: Path, tmp_path: Path) -> None:
    other = shutil.copytree(full_run, tmp_path / "other")
    with edited_manifest(other) as content:
        content["data"]["conductivity-set"]["hash"] = "77c0ffee"
    text = FORMATS["html"](ranked_rows([full_run, other]))
    assert re.findall("<caption>(.*)</caption>", text) == [
        "bench / conductivity-set (n = 8, data 3f2a1b): sensor foam16, SNR 50 dB, 8 test samples",
        "bench / position-set: sensor disc, 8 test samples",
        "bench / classes-set: sensor disc, 8 test samples",
        "bench / none-set: sensor disc, 8 test samples",
        "bench / conductivity-set (n = 8, data 77c0ff): sensor foam16, SNR 50 dB, 8 test samples",
    ]


def test_the_best_and_what_is_told_of_it(build: Any, dataset_of: Any) -> None:
    shares = {"good": 0.9, "as-good": 0.9, "poor": 0.5, "broken": 0.9}
    build.add_scaled(dataset_of("conductivity", 24), shares, noise=0.02, lost={"broken": 24})
    rows = {row["method"]: row for row in ranked_rows([build.write()])}
    text = FORMATS["md"](list(rows.values()))
    lines = {name: next(x for x in text.splitlines() if f" {name} " in x) for name in rows}
    assert rows["poor"]["group"] == "b"
    assert {rows["good"]["group"], rows["as-good"]["group"]} == {"a"}
    assert lines["good"].startswith(f"| {rows['good']['rank']} (1–2) | good | a | ")
    assert lines["poor"].startswith("| 3 | poor | b | ")
    score, low, high = (rows["poor"][f"score{end}"] for end in ("", "_low", "_high"))
    assert f" {score:.3f} ({low:.3f}–{high:.3f}) " in lines["poor"]
    assert "**" not in lines["poor"] + lines["broken"].replace("**0.25**", "")
    assert "**" in lines["good"] + lines["as-good"]
    assert r"1 {\scriptsize(1--2)} & " in FORMATS["latex"](list(rows.values()))


NOTES = {"guess_mm": 35.52, "reciprocity_error": 0.026, "repeat_noise": 0.000316}
NOTE = "always guessing one place gives 35.5 mm; reciprocity error of the reference frame: 2.60%; "


@pytest.mark.parametrize("form", ["md", "html", "latex", "terminal"])
def test_what_is_known_of_recorded_data_stands_below_their_table(
    full_run: Path, form: str, printed: Callable[..., str]
) -> None:
    rows = ranked_rows([full_run])
    noted = [row | (NOTES if row["scenario"] == "position-set" else {}) for row in rows]
    assert "guessing" not in printed(rows, form)
    text = " ".join(printed(noted, form).replace("\\", "").split())
    assert text.count(f"{NOTE}noise between repeats: 0.032%.") == 1
    after = text.index("guessing")
    assert text.index("position-set") < after < text.index("classes-set")
    assert note([row | {"why_not": ""} for row in noted if row["scenario"] == "none-set"]) == ""


def test_the_title_names_sensor_noise_samples_and_mesh(build: Any, dataset_of: Any) -> None:
    build.suite = "bench"
    run = build.add_scaled(dataset_of("conductivity", 2, scenario="bench"), {"one": 0.5}).write()
    with edited_manifest(run) as content:
        content["data"]["bench"] |= {"sensor": "foam16", "inverse_crime": False}
    (board,) = printed_boards(ranked_rows([run]))
    assert board.title == (
        "bench: sensor foam16, SNR 50 dB, 2 test samples, data from another mesh than methods "
        "invert with"
    )


@pytest.mark.parametrize("form", ["md", "html", "latex", "terminal"])
def test_few_samples_and_untuned_methods_among_tuned_ones_are_told(
    build: Any, dataset_of: Any, form: str, printed: Callable[..., str]
) -> None:
    build.add_scaled(dataset_of("conductivity", 4), {"chosen": 0.9, "as-it-came": 0.5})
    rows = ranked_rows([build.write()])
    assert "not tuned" not in printed(rows, form)
    mixed = [row | {"track": "tuned" if row["method"] == "chosen" else "default"} for row in rows]
    said = " ".join(printed(mixed, form).split())
    assert "no ties: intervals and ties need at least 10 independent sessions" in said
    assert "not tuned, beside methods that are: as-it-came" in said


@pytest.mark.parametrize("form", ["md", "html", "latex", "terminal"])
def test_letters_and_directions_are_explained(
    many_rows: list[dict[str, Any]], form: str, printed: Callable[..., str]
) -> None:
    said = " ".join(html.unescape(printed(many_rows, form, 300)).split())
    more, less = ("$\\uparrow$", "$\\downarrow$") if form == "latex" else ("↑", "↓")
    assert re.search(rf"{re.escape(more)} more is better: S, [^;]*SSIM", said)
    assert re.search(rf"{re.escape(less)} less is better: [^;]*RIE", said)
    assert "S: 0.25 (SSIM + CC + PSNR - RIE)" in said
    assert "Ties: methods that share a letter cannot be told apart" in said


@pytest.mark.parametrize("width", [60, 80, 100, 400])
def test_columns_that_do_not_fit_a_terminal_are_named(
    many_rows: list[dict[str, Any]], width: int, printed: Callable[..., str]
) -> None:
    text = printed(many_rows, "terminal", width)
    heads, said = text[: text.index("───")], " ".join(text.split())
    hidden = re.search(r"Hidden at this width: (.*?); see them in a wider terminal", said)
    names = hidden[1].split(", ") if hidden else []
    shown = [name for name in ("S", "B", "CC", "RIE", "PSNR", "Track") if f" {name} " in heads]
    assert sorted({"S", "B", "CC", "RIE", "PSNR", "Track"} - {*shown}) == sorted(
        {"S", "B", "CC", "RIE", "PSNR", "Track"} & {*names}
    )
    assert (hidden is None) == (width == 400)
    assert "In files only: p99 [ms], " in said
    assert "`eitbench leaderboard RUN --format md`" in said


def test_latex_has_a_label_arrows_and_keys_of_the_bibliography(
    full_run: Path, build: Any, dataset_of: Any
) -> None:
    build.add_scaled(dataset_of("conductivity", 12), {"noser": 0.9, "mine": 0.5, "phydnn": 0.7})
    text = FORMATS["latex"](ranked_rows([build.write(), full_run]))
    labels = re.findall(r"\\label\{(.*)\}", text)
    assert labels[0].startswith("tab:bench-conductivity-set")
    assert len(set(labels)) == len(labels) == text.count("\\begin{table*}")
    assert "& S $\\uparrow$ & " in text
    assert "& RIE $\\downarrow$ & " in text
    assert "12 test samples" in text
    assert "mine & " in text
    cited = set(re.findall(r"\\cite\{(.*?)\}", text))
    assert cited == {"eitbench", "cheney1990", "phydnn", "suite-bench"}
    assert cited - {"suite-bench"} <= set(entries())


@pytest.mark.slow
def test_a_caption_cites_suite_and_recording_as_the_bibliography_does(
    full_run: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(full_run, tmp_path / "run")
    with edited_manifest(run) as content:
        content["plan"]["suite"]["scenarios"] = [
            {"name": "position-set", "recording": "ohmc16"},
            {"name": "classes-set", "recording": "/home/me/touch.h5"},
        ]
    text = FORMATS["latex"](ranked_rows([run]))
    assert text.count("data~\\cite{suite-bench}") == 3
    assert text.count("data~\\cite{suite-bench,hardman2023}") == 1
    write_paper(report_data([run]), tmp_path)
    assert (tmp_path / "tables" / "leaderboard.tex").read_text() == text
    written = (tmp_path / "references.bib").read_text()
    assert "{suite-bench," in written
    assert "{hardman2023," in written


@pytest.mark.parametrize(
    ("form", "value", "text"),
    [
        (TIME, 8.71e-7, "<0.001"),
        (TIME, 0.0, "0"),
        (TIME, 0.00123, "0.001"),
        (TIME, 0.01267, "0.013"),
        (TIME, 0.5, "0.5"),
        (TIME, 12.345, "12.3"),
        (TIME, 100, "100"),
        (TIME, 123456.0, "123000"),
        (SMALL, 0.0, "0"),
        (SMALL, 1e-24, "1.00e-24"),
        (SMALL, 1.62e-2, "1.62e-2"),
        (SMALL, 0.0999, "9.99e-2"),
        (SMALL, 0.425, "0.425"),
        (SMALL, 12.345, "12.3"),
        (SMALL, None, "–"),
    ],
)
def test_times_have_no_exponent_and_small_numbers_are_legible(
    form: str, value: float | None, text: str
) -> None:
    assert Column("it", "It", form).text({"it": value}) == text
    times = [c for c in LAYOUT.columns if c.name.endswith(("_s", "_ms_p50", "_ms_p99"))]
    assert [column.form for column in times] == [TIME] * 4


def test_a_metric_has_one_name(full_run: Path) -> None:
    title = METRICS["repeatability_db"].title
    assert title in FORMATS["md"](ranked_rows([full_run]))
    assert LAYOUT.terminal["repeatability_db"].startswith(title)


def test_what_failures_cost_is_said(build: Any, dataset_of: Any) -> None:
    shares = {"good": 0.9, "fair": 0.8}
    build.add_scaled(dataset_of("conductivity", 12), shares, lost={"good": 6})
    rows = ranked_rows([build.write()])
    assert [(row["method"], row["rank_valid"]) for row in rows] == [("fair", 2), ("good", 1)]
    said = "good failed on some samples: if such of each method were left out, its rank would be 1"
    assert said in FORMATS["md"](rows)
    assert "fair would" not in FORMATS["md"](rows)


def test_a_board_tells_of_network_programs_and_test_data(build: Any, dataset_of: Any) -> None:
    run = build.add_scaled(dataset_of("conductivity", 3), {"calls": 0.9, "quiet": 0.5}).write()
    cells = pd.read_parquet(run / "methods.parquet")
    done = {"network": ["socket.connect to ('192.0.2.1', 80)"], "read": ["/etc/hosts"]}
    cells["actions"] = [json.dumps(done), ""]
    cells.to_parquet(run / "methods.parquet")
    told = notes(ranked_rows([run]))
    assert "calls: used the network (socket.connect to ('192.0.2.1', 80))" in told
    assert not any("quiet" in text or "/etc/hosts" in text for text in told)
    cells.assign(actions="{").to_parquet(run / "methods.parquet")
    with pytest.raises(DataCorruptError, match="'actions'"):
        ranked_rows([run])
