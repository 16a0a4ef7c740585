"""The command line: answers, exit codes, one sentence for every error, Ctrl-C."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.main import get_command

from eitbench import __version__, cli
from eitbench.commands import console

DATA = Path(__file__).parents[1] / "benchmark" / "data"
TINY, TOYS = str(DATA / "tiny.toml"), str(DATA / "toy_methods.py")
OPERATORS = str(DATA / "tiny-operators.toml")

Run = Callable[..., tuple[int, str, str]]


def commands(group: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Every command and group of commands, as words."""
    found = [path]
    for name, command in getattr(group, "commands", {}).items():
        found += commands(command, (*path, name))
    return found


COMMANDS = commands(get_command(cli.app))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command: tuple[str, ...], eitbench: Run) -> None:
    code, out, _ = eitbench(*command, "--help")
    assert code == 0
    assert f"Example: eitbench {' '.join(command)}" in " ".join(out.split())


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys\n"
        "from eitbench import cli\n"
        "sys.argv = ['eitbench', '--help']\n"
        "try:\n    cli.main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'pyarrow', 'h5py', 'matplotlib', 'pydantic'}\n"
        "heavy |= {'torch', 'numba'}\n"
        "sys.exit(str(sorted(heavy & set(sys.modules)) or ''))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stderr.strip() == ""
    assert "leaderboard" in done.stdout


def test_version(eitbench: Run) -> None:
    assert eitbench("--version") == (0, f"eitbench {__version__}\n", "")


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("methods", "noser"),
        ("operators", "fem"),
        ("scenarios", "quick"),
        ("sensors", "foam16"),
        ("suites", "paper"),
        ("recordings", "ohmc16"),
        ("boards", "teensy"),
    ],
)
def test_list(what: str, name: str, eitbench: Run) -> None:
    code, out, err = eitbench("list", what)
    assert (code, err) == (0, "")
    assert name in out
    code, out, _ = eitbench("list", what, "--json")
    assert code == 0
    assert name in {row["name"] for row in json.loads(out)}


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("run", "qiuck"), 2, "Unknown suite 'qiuck': did you mean 'quick'?"),
        (("run", TINY, "--methods", "nosr"), 2, "Unknown method 'nosr': did you mean 'noser'?"),
        (("run", TINY, "--operators", "fem"), 2, "Suite 'tiny' ranks methods: choose among them"),
        (("run", OPERATORS, "--operators", "fme"), 2, "Unknown operator 'fme': did you mean 'fem'"),
        (("run", OPERATORS, "--methods", "noser"), 2, "ranks operators: choose among them with"),
        (("tune", OPERATORS), 2, "ranks operators: name one of methods (eitbench list suites)"),
        (("run", TINY, "--scenarios", "tinny"), 2, "did you mean 'tiny'?"),
        (("run", "no-such.toml"), 2, "Cannot read the suite file no-such.toml"),
        (("run", TINY, "--plugin", "no-such.py"), 2, "A plugin is a Python file that exists"),
        (("run", "--resume", "no-such-run"), 2, "is not a run directory"),
        (("check", "nosr"), 2, "Unknown method or operator 'nosr': did you mean 'noser'?"),
        (("check", "no-such.py"), 2, "A plugin is a Python file that exists"),
        (("new-method", "No Good"), 2, "cannot name a new method"),
        (("recordings", "fetch", "ohmc61"), 2, "Unknown recorded set 'ohmc61'"),
        (("leaderboard", "no-such-run"), 2, "no-such-run"),
        (("emulate", "--protocol", "tensy"), 2, "Unknown protocol 'tensy': did you mean 'teensy'"),
        (("emulate", "--speed", "0"), 2, "runs at a speed above 0"),
        (("reproduce", "--runs", "no-such-run"), 2, "no-such-run is not a run directory"),
    ],
)
def test_errors_are_one_sentence(
    arguments: tuple[str, ...], code: int, sentence: str, eitbench: Run
) -> None:
    found, out, err = eitbench(*arguments)
    assert found == code
    assert out == ""
    assert err.startswith("eitbench: ")
    assert sentence in err
    assert err.count("\n") == 1
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("run",), "Name a suite"),
        (("run", TINY, "--limit", "0"), "'--limit'"),
        (("run", TINY, "--jobs", "none"), "'--jobs'"),
        (("run", TINY, "--no-such-option"), "--no-such-option"),
        (("run", TINY, "--methods", ","), "--methods names nothing"),
        (("run", TINY, "--methods", ""), "--methods names nothing"),
        (("run", TINY, "--scenarios", " , "), "--scenarios names nothing"),
        (("run", "--resume", "somewhere", "--methods", "noser"), "A resumed run keeps its choices"),
        (("run", "--resume", "somewhere", "--methods", ""), "A resumed run keeps its choices"),
        (("run", "--resume", "somewhere", "--operators", "a"), "A resumed run keeps its choices"),
        (("tune",), "Missing argument"),
        (("reproduce", "--runs", "somewhere", "--limit", "5"), "--runs are judged as they are"),
        (("list", "nonsense"), "nonsense"),
        (("no-such-command",), "no-such-command"),
    ],
)
def test_bad_usage_is_one_sentence_and_exits_2(
    arguments: tuple[str, ...], says: str, eitbench: Run
) -> None:
    code, out, err = eitbench(*arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("eitbench: ")
    assert says in err
    assert err.count("\n") == 1
    assert err.endswith("--help`.\n")


def test_a_suite_that_names_an_unknown_method_is_named(tmp_path: Path, eitbench: Run) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(Path(TINY).read_text().replace('"noser"', '"nosr"'))
    place = f"Suite file {path}, field 'methods': "
    for command in ("run", "tune"):
        code, _, err = eitbench(command, str(path))
        assert (code, err) == (
            2, f"eitbench: {place}Unknown method 'nosr': did you mean 'noser'?\n"
        )  # fmt: skip
    _, _, err = eitbench("run", str(path), "--methods", "tvv")
    assert err.startswith("eitbench: Unknown method 'tvv'")


def test_a_suite_that_names_an_unknown_operator_is_named(tmp_path: Path, eitbench: Run) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(Path(OPERATORS).read_text().replace('"jacobian"', '"jacobina"'))
    code, _, err = eitbench("run", str(path))
    assert code == 2
    assert f"Suite file {path}, field 'operators': Unknown operator 'jacobina'" in err


def test_without_a_command_the_help_is_shown(eitbench: Run) -> None:
    code, out, err = eitbench()
    assert code == 2
    assert "Usage: eitbench" in out + err


@pytest.mark.parametrize(
    "what", ["methods", "operators", "scenarios", "sensors", "suites", "recordings"]
)
@pytest.mark.parametrize("width", [40, 80])
def test_names_in_a_list_are_never_cut(
    what: str, width: int, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [row["name"] for row in json.loads(eitbench("list", what, "--json")[1])]
    monkeypatch.setattr(console, "width", lambda: width)
    _, out, _ = eitbench("list", what)
    assert {line.split(" ")[0] for line in out.splitlines()} >= set(names)
    assert max(map(len, out.splitlines())) <= width


def test_recordings_are_listed_with_what_to_cite(eitbench: Run) -> None:
    rows = json.loads(eitbench("list", "recordings", "--json")[1])
    assert all(row["citation"] and row["licence"] and row["source"] for row in rows)
    assert "citation" not in eitbench("list", "recordings")[1]


def test_fetch_reports_the_folder_that_holds_the_set(recorded_data: Path, eitbench: Run) -> None:
    folder = recorded_data / "DSHardman" / "HydrogelEIT"
    assert eitbench("recordings", "fetch", "ohmc16") == (0, f"ohmc16 is in {folder}\n", "")


def test_a_limit_above_the_split_is_said(tmp_path: Path, eitbench: Run) -> None:
    code, _, err = eitbench("run", TINY, "--limit", "99", "--out", str(tmp_path / "run"))
    assert code == 0
    assert err.splitlines()[-1] == (
        "eitbench: Scenario 'tiny' has only 5 test samples: --limit 99 is above."
    )


@pytest.mark.parametrize(("refused", "code"), [((), 0), (("Scenario 'b' is damaged.",), 1)])
def test_skipped_and_refused_scenarios_are_repeated_below(
    refused: tuple[str, ...],
    code: int,
    tmp_path: Path,
    eitbench: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from eitbench.benchmark.run import runner

    start = runner.start_run

    def started(*arguments: Any, **options: Any) -> runner.RunResult:
        result = start(*arguments, **options)
        skipped = ("Scenario 'a' is skipped.",)
        return dataclasses.replace(result, skipped=skipped, refused=refused)

    monkeypatch.setattr(runner, "start_run", started)
    found, out, _ = eitbench("run", TINY, "--limit", "1", "--out", str(tmp_path / "run"))
    assert found == code
    lines = [line.strip() for line in out.splitlines()]
    sentences = ["Scenario 'a' is skipped.", *refused]
    first = lines.index(sentences[0])
    assert lines[first : first + len(sentences)] == sentences
    assert any("noser" in line for line in lines[:first])


def test_a_run_without_rows_says_so(
    tmp_path: Path, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from eitbench.reports.tables import leaderboard

    monkeypatch.setattr(leaderboard, "leaderboard", lambda runs: [])
    code, out, err = eitbench("leaderboard", str(tmp_path))
    assert (code, out.strip()) == (0, "")
    assert err == f"eitbench: There are no rows in {tmp_path}: nothing was finished there.\n"


def test_a_traceback_only_with_debug(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["eitbench", "run", "qiuck", "--debug"])
    with pytest.raises(ValueError, match="Unknown suite"):
        cli.main()


def test_ctrl_c_is_one_sentence(monkeypatch: pytest.MonkeyPatch, eitbench: Run) -> None:
    from eitbench.commands import listing

    def interrupted() -> list[listing.Row]:
        raise KeyboardInterrupt

    monkeypatch.setitem(listing.LISTINGS, "suites", interrupted)
    assert eitbench("list", "suites") == (130, "", "eitbench: Interrupted.\n")


def test_a_bug_is_one_sentence_too(monkeypatch: pytest.MonkeyPatch, eitbench: Run) -> None:
    from eitbench.commands import listing

    monkeypatch.setitem(listing.LISTINGS, "suites", lambda: [1 / 0])
    code, _, err = eitbench("list", "suites")
    assert code == 1
    assert err == (
        "eitbench: Unexpected ZeroDivisionError: division by zero. Add --debug for the traceback, "
        "and please report it.\n"
    )


def test_a_reader_that_stops_early_is_no_error() -> None:
    program = f"{sys.executable} -m eitbench.cli list recordings --json | head -n 1"
    done = subprocess.run(program, shell=True, capture_output=True, text=True)  # noqa: S602
    assert done.stdout == "[\n"
    assert done.stderr == ""


def test_a_run_prints_its_leaderboard_and_where_everything_is(
    tmp_path: Path, eitbench: Run
) -> None:
    out_folder = tmp_path / "first"
    code, out, err = eitbench(
        "run", TINY, "--plugin", TOYS, "--methods", "noser,toy-raises", "--out", str(out_folder)
    )
    assert code == 0
    assert "noser" in out
    assert str(out_folder) in out
    assert "'toy-raises' on 'tiny': 5 samples failed, the first (error): " in out
    assert ".png" in out
    assert "[2/2]" in err
    for name in ("leaderboard.json", "leaderboard.csv", "leaderboard.md", "samples.parquet"):
        assert (out_folder / name).is_file()
    assert list((out_folder / "figures").glob("*.png"))
    rows = json.loads((out_folder / "leaderboard.json").read_text())
    assert {row["method"]: row["coverage"] for row in rows} == {"noser": 1.0, "toy-raises": 0.0}

    code, out, _ = eitbench("leaderboard", str(out_folder), "--format", "json")
    assert code == 0
    assert json.loads(out) == rows
    code, out, _ = eitbench("leaderboard", str(out_folder), "--format", "latex")
    assert "\\toprule" in out
    code, out, _ = eitbench("leaderboard", str(out_folder))
    assert "noser" in out

    code, _, err = eitbench("run", TINY, "--out", str(out_folder))
    assert code == 2
    assert "is not empty: choose another with --out" in err
    code, _, err = eitbench("run", TINY, "--out", str(out_folder / "manifest.json" / "run"))
    assert code == 1
    assert "Could not write" in err


def test_operators_are_run_and_printed_like_methods(tmp_path: Path, eitbench: Run) -> None:
    folder = tmp_path / "operators"
    choice = ("--scenarios", "tiny-finer", "--limit", "2")
    code, out, err = eitbench("run", OPERATORS, *choice, "--out", str(folder))
    assert code == 0
    assert "(published)" not in out  # these are not the paper's phantoms
    assert "[2/2]" in err
    rows = json.loads((folder / "leaderboard.json").read_text())
    assert [(row["operator"], row["n"], row["coverage"]) for row in rows] == [("jacobian", 2, 1.0)]
    assert json.loads(eitbench("leaderboard", str(folder), "--format", "json")[1]) == rows
    assert eitbench("leaderboard", str(folder), "--format", "md")[1] == (
        folder / "leaderboard.md"
    ).read_text(encoding="utf-8")


def test_runs_are_compared_gated_and_scored_again(tmp_path: Path, eitbench: Run) -> None:
    suite = tmp_path / "twelve.toml"
    suite.write_text(Path(TINY).read_text().replace("test = 5", "test = 12"))
    one, other = str(tmp_path / "one"), str(tmp_path / "other")
    for folder in (one, other):
        assert eitbench("run", str(suite), "--out", folder)[0] == 0
    code, out, err = eitbench("compare", one, other)
    assert (code, err) == (0, "")
    assert " equal" in out
    baseline = tmp_path / "other" / "samples.parquet"
    code, out, _ = eitbench("gate", one, "--baseline", str(baseline))
    assert (code, out.splitlines()[-1].split(":")[0]) == (0, "Gate passed")

    table = pd.read_parquet(baseline)
    table.assign(score=table["score"] + 1).to_parquet(baseline)
    code, out, _ = eitbench("gate", one, "--baseline", str(baseline), "--margin", "score=0.5")
    assert code == 1
    assert out.splitlines()[-1] == (
        "Gate failed: 1 of 1 figures are surely worse by more than is allowed; 0 things missing."
    )
    code, out, _ = eitbench("gate", one, "--baseline", str(baseline), "--margin", "score=2")
    assert code == 0
    code, out, _ = eitbench("compare", one, other, "--json", "--figures", "score,rie")
    verdicts = [change["verdict"] for change in json.loads(out)["changes"]]
    assert verdicts == ["better", "equal"]

    code, out, _ = eitbench("rescore", other)
    assert code == 0
    assert out.splitlines() == [
        "tiny  noser  12 of 12 changed: score",
        "Scored again: 12 samples, of which 12 changed.",
    ]
    assert json.loads(eitbench("gate", one, "--baseline", other, "--json")[1])["passed"]
    manifest = tmp_path / "one" / "manifest.json"
    manifest.write_text(manifest.read_text()[:1000])
    code, _, err = eitbench("gate", one, "--baseline", other)
    assert code == 1
    assert "manifest.json cannot be read" in err


@pytest.mark.parametrize("margin", ["score", "score=-1", "score=much", "=1"])
def test_a_margin_is_a_figure_and_a_loss(tmp_path: Path, eitbench: Run, margin: str) -> None:
    code, _, err = eitbench("gate", str(tmp_path), "--baseline", str(tmp_path), "--margin", margin)
    assert code == 2
    assert "FIGURE=LOSS" in err or "neither a run directory" in err


def test_the_claims_are_judged_by_runs_that_are_given(tmp_path: Path, eitbench: Run) -> None:
    one, out_folder = tmp_path / "one", tmp_path / "claims"
    assert eitbench("run", TINY, "--limit", "1", "--out", str(one))[0] == 0
    code, out, err = eitbench("reproduce", "--runs", str(one), "--out", str(out_folder))
    assert (code, err) == (0, "")
    found = json.loads((out_folder / "claims.json").read_text())
    # The suite is another than the paper's, so that it says nothing of any claim.
    assert {claim["verdict"] for claim in found["claims"]} == {"not testable"}
    assert [run["command_line"].split(" ")[:2] for run in found["runs"]] == [["eitbench", "run"]]
    for claim in found["claims"]:
        assert claim["id"] in out
    for form in ("md", "json", "html"):
        assert f"Ledger: {out_folder / f'claims.{form}'}" in out
    assert sorted(path.name for path in out_folder.iterdir()) == [
        "claims.html", "claims.json", "claims.md", "losses.pdf", "losses.png",
    ]  # fmt: skip


def test_what_the_claims_need_is_run(
    tmp_path: Path, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from eitbench.benchmark.rundir.plan import make_plan
    from eitbench.benchmark.studies import reproduce
    from eitbench.scenarios.suites.suite import load_suite

    monkeypatch.setattr(
        reproduce, "_plans", lambda limit: [make_plan(load_suite(TINY), limit=limit)]
    )
    code, out, _ = eitbench("reproduce", "--limit", "2", "--out", str(tmp_path / "all"))
    assert code == 0
    assert "not testable" in out
    for name in ("claims.md", "tiny/manifest.json", "tiny/leaderboard.md", "tiny/figures"):
        assert (tmp_path / "all" / name).exists()


def test_json_for_programs(tmp_path: Path, eitbench: Run) -> None:
    code, out, _ = eitbench("run", TINY, "--limit", "2", "--out", str(tmp_path / "run"), "--json")
    assert code == 0
    answer = json.loads(out)
    assert answer["run"] == str(tmp_path / "run")
    assert [row["n"] for row in answer["leaderboard"]] == [2]
    assert answer["skipped"] == []


EXCUSES = """
from eitbench.methods import register
from eitbench.methods.classical.back_projection import BackProjection


@register("cli-excused")
class Excused(BackProjection):
    expected_failures = {"prints nothing": "it is a talker."}

    def reconstruct(self, voltages):
        print("hello")
        return super().reconstruct(voltages)


@register("cli-outdated")
class Outdated(BackProjection):
    expected_failures = {"prints nothing": "it was a talker."}
"""


def test_check_says_how_many_ran(eitbench: Run, tmp_path: Path) -> None:
    code, out, _ = eitbench("check", "noser", "--json")
    assert code == 0
    (report,) = json.loads(out)
    counts = {status: report[status] for status in ("ran", "passed", "failed", "xfail", "skipped")}
    assert counts == {"ran": 26, "passed": 26, "failed": 0, "xfail": 0, "skipped": 0}
    code, out, _ = eitbench("check", "jacobian")
    assert code == 0
    assert "skipped  obeys the scaling law\n         Only exact operators" in out
    assert "jacobian on foam16, 16 x 16: 19 checks ran, 19 passed, 0 failed, 1 skipped." in out
    plugin = tmp_path / "excuses.py"
    plugin.write_text(EXCUSES)
    code, out, _ = eitbench("check", plugin)
    assert code == 1
    said = "reconstruct prints: 'hello'. Expected: it is a talker."
    assert f"xfail    prints nothing\n         {said}\n" in out
    assert (
        "cli-excused on foam16, 40 x 40: 26 checks ran, 25 passed, 0 failed, 1 failed as expected."
    ) in out
    said = "it passes although it is expected to fail (it was a talker): remove it."
    assert f"FAILED   prints nothing\n         {said}\n" in out
    assert "cli-outdated on foam16, 40 x 40: 26 checks ran, 25 passed, 1 failed." in out


def test_new_method_says_what_is_next(tmp_path: Path, eitbench: Run) -> None:
    code, out, _ = eitbench("new-method", "my-method", str(tmp_path / "package"))
    assert code == 0
    assert "eitbench check my-method" in out
    code, out, _ = eitbench("check", str(tmp_path / "package" / "eitbench_my_method.py"))
    assert code == 0


SMALL_BATCHES = """
import sys
from eitbench.benchmark.run.method_cell import MethodData
from eitbench import cli
MethodData.batch = 1
cli.main()
"""


@pytest.mark.skipif(os.name == "nt", reason="sends the signal that Ctrl-C sends")
def test_ctrl_c_keeps_finished_rows_and_resume_continues(
    tmp_path: Path, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    from eitbench.benchmark.run.method_cell import MethodData

    cut, whole = tmp_path / "cut", tmp_path / "whole"
    choice = (TINY, "--plugin", TOYS, "--methods", "toy-random,toy-slow")
    command = [sys.executable, "-c", SMALL_BATCHES, "run", *choice, "--out", str(cut)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not list((cut / "parts").glob("tiny/toy-slow/test-*.npz")):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert f"eitbench run --resume {cut}" in err.splitlines()[-1]
    assert "Traceback" not in err
    kept = pd.read_parquet(cut / "samples.parquet")
    assert set(kept["method"]) == {"toy-random", "toy-slow"}
    assert (kept["status"] == "ok").all()
    assert 5 < len(kept) < 10

    code, out, _ = eitbench("run", "--resume", str(cut))
    assert code == 0
    assert "toy-slow" in out
    assert not (cut / "parts").exists()
    monkeypatch.setattr(MethodData, "batch", 1)
    code, _, _ = eitbench("run", *choice, "--out", str(whole))
    assert code == 0
    order = ["method", "sample"]
    resumed, uninterrupted = (
        pd.read_parquet(run / "samples.parquet").sort_values(order, ignore_index=True)
        for run in (cut, whole)
    )
    exact = uninterrupted.columns.drop("frame_ms")
    pd.testing.assert_frame_equal(resumed[exact], uninterrupted[exact], check_exact=True)
    assert np.isfinite(resumed["frame_ms"]).all()
