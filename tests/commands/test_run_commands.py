"""Commands on runs: run and resume, leaderboard, compare, gate, rescore, reproduce."""

import json
import shutil
import signal
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from eitbench.benchmark.run import executors, runner
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.studies import reproduce
from eitbench.benchmark.workers import confinement
from eitbench.benchmark.workers.confinement import check_isolation
from eitbench.reports.tables import leaderboard
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import cached_folder
from eitbench.scenarios.suites.suite import load_suite

DATA = Path(__file__).parents[1] / "benchmark" / "data"
TINY, TOYS = str(DATA / "tiny.toml"), str(DATA / "toy_methods.py")
OPERATORS = str(DATA / "tiny-operators.toml")

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of `noser` on 12 samples; to be read only."""
    folder = tmp_path_factory.mktemp("stored")
    suite = folder / "twelve.toml"
    suite.write_text(Path(TINY).read_text().replace("test = 5", "test = 12"))
    return runner.start_run(runner.make_plan(load_suite(suite)), folder / "run").path


@pytest.mark.slow
def test_a_run_prints_its_leaderboard_and_where_everything_is(
    tmp_path: Path, eitbench: Run
) -> None:
    folder = tmp_path / "first"
    code, out, err = eitbench(
        "run", TINY, "--plugin", TOYS, "--methods", "noser,toy-raises", "--out", folder
    )
    assert code == 0
    for part in ("noser", "'toy-raises' on 'tiny': 5 samples failed", str(folder), ".png"):
        assert part in out
    assert "[2/2]" in err
    for name in ("leaderboard.json", "leaderboard.csv", "leaderboard.md", "samples.parquet"):
        assert (folder / name).is_file()
    assert list((folder / "figures").glob("*.png"))
    rows = json.loads((folder / "leaderboard.json").read_text())
    assert {row["method"]: row["coverage"] for row in rows} == {"noser": 1.0, "toy-raises": 0.0}

    code, out, _ = eitbench("leaderboard", folder, "--format", "json")
    assert (code, json.loads(out)) == (0, rows)
    assert "\\toprule" in eitbench("leaderboard", folder, "--format", "latex")[1]
    assert "noser" in eitbench("leaderboard", folder)[1]

    code, _, err = eitbench("run", TINY, "--out", folder)
    assert code == 2
    assert "--out" in err
    code, _, err = eitbench("run", TINY, "--out", folder / "manifest.json" / "run")
    assert code == 1
    assert "manifest.json" in err


def test_a_run_without_any_image_ends_with_an_error(tmp_path: Path, eitbench: Run) -> None:
    folder = tmp_path / "first"
    choice = ("--plugin", TOYS, "--methods", "toy-raises", "--limit", "2", "--out", folder)
    code, out, _ = eitbench("run", TINY, *choice)
    assert code == 1
    assert "'toy-raises' on 'tiny': 2 samples failed" in out
    assert (folder / "leaderboard.json").is_file()


@pytest.mark.slow
def test_operators_are_run_and_printed_like_methods(tmp_path: Path, eitbench: Run) -> None:
    folder = tmp_path / "operators"
    choice = ("--scenarios", "tiny-finer", "--limit", "2")
    code, out, err = eitbench("run", OPERATORS, *choice, "--out", folder)
    assert code == 0
    assert "(published)" not in out  # these are not the paper's phantoms
    assert "[2/2]" in err
    rows = json.loads((folder / "leaderboard.json").read_text())
    assert [(row["operator"], row["n"], row["coverage"]) for row in rows] == [("jacobian", 2, 1.0)]
    assert json.loads(eitbench("leaderboard", folder, "--format", "json")[1]) == rows
    markdown = (folder / "leaderboard.md").read_text(encoding="utf-8")
    assert eitbench("leaderboard", folder, "--format", "md")[1] == markdown


@pytest.mark.slow
@pytest.mark.parametrize(("refused", "code"), [([], 0), (["Scenario 'b' is damaged."], 1)])
def test_skipped_and_refused_scenarios_are_told_to_people_and_programs(
    refused: list[str], code: int, stored: Path, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = runner.RunResult(stored, ("Scenario 'a' is skipped.",), tuple(refused))
    monkeypatch.setattr(runner, "start_run", lambda *arguments, **options: result)
    found, out, _ = eitbench("run", TINY)
    assert found == code
    table, _, below = out.partition("Scenario 'a' is skipped.\n")
    assert "noser" in table
    assert below.startswith("".join(f"{sentence}\n" for sentence in refused))

    found, out, err = eitbench("run", TINY, "--limit", "99", "--json")
    assert found == code
    answer = json.loads(out)
    assert answer["run"] == str(stored)
    assert [row["n"] for row in answer["leaderboard"]] == [12]
    assert (answer["skipped"], answer["refused"]) == (["Scenario 'a' is skipped."], refused)
    assert "only 12 test samples, fewer than --limit 99" in err


def test_a_run_without_rows_is_told(
    tmp_path: Path, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leaderboard, "ranked_rows", lambda runs, columns: [])
    code, out, err = eitbench("leaderboard", tmp_path)
    assert (code, out) == (2, "")
    assert str(tmp_path) in err


@pytest.mark.slow
def test_ctrl_c_keeps_finished_rows_and_resume_continues(
    tmp_path: Path,
    eitbench: Run,
    monkeypatch: pytest.MonkeyPatch,
    end_run: Callable[[int], None],
) -> None:
    cut, whole = tmp_path / "cut", tmp_path / "whole"
    choice = (TINY, "--plugin", TOYS, "--methods", "toy-random,noser")
    save = RunStore.save_batch
    saved: list[str] = []

    def save_and_interrupt(store: RunStore, cell: Any, *arguments: Any) -> None:
        save(store, cell, *arguments)
        saved.append(cell.name)
        if len(saved) == 7:
            end_run(signal.SIGINT)

    monkeypatch.setattr(MethodData, "batch", 1)
    with monkeypatch.context() as patch:
        patch.setattr(RunStore, "save_batch", save_and_interrupt)
        code, _, err = eitbench("run", *choice, "--out", cut)
    assert code == 130
    assert f"eitbench run --resume {cut}" in err.splitlines()[-1]
    kept = pd.read_parquet(cut / "samples.parquet")
    assert set(kept["method"]) == {"toy-random", "noser"}
    assert (kept["status"] == "ok").all()
    assert 5 < len(kept) < 10

    code, out, _ = eitbench("run", "--resume", cut)
    assert code == 0
    assert "toy-random" in out
    assert not (cut / "parts").exists()
    assert eitbench("run", *choice, "--out", whole)[0] == 0
    resumed, uninterrupted = (
        pd.read_parquet(run / "samples.parquet").sort_values(["method", "sample"])
        for run in (cut, whole)
    )
    exact = uninterrupted.columns.drop(["frame_ms", "uncertainty_ms"], errors="ignore")
    pd.testing.assert_frame_equal(
        resumed[exact].reset_index(drop=True),
        uninterrupted[exact].reset_index(drop=True),
        check_exact=True,
    )
    assert resumed["frame_ms"].notna().all()


def test_a_time_limit_ends_a_run_that_can_be_resumed(tmp_path: Path, eitbench: Run) -> None:
    folder = tmp_path / "run"
    code, out, _ = eitbench("run", TINY, "--limit", "2", "--time-limit", "0", "--out", folder)
    assert code == 0
    assert (
        "The time limit of 0 s ended the run: 1 of 1 cell (scenario x method) is not finished. "
        "Continue with "
        f"`eitbench run --resume {folder}`."
    ) in out
    assert json.loads((folder / "manifest.json").read_text())["status"] == "interrupted"
    code, out, _ = eitbench("run", "--resume", folder, "--json", "--time-limit", "600")
    found = json.loads(out)
    assert (found["unfinished"], len(found["leaderboard"])) == ("", 1)
    code, _, err = eitbench("run", TINY, "--time-limit", "inf", "--out", tmp_path / "other")
    assert code == 2
    assert "A time limit is a number of seconds, got inf." in err


@pytest.mark.slow
def test_runs_are_compared_gated_and_scored_again(
    stored: Path, tmp_path: Path, eitbench: Run
) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    for folder in (one, other):
        shutil.copytree(stored, folder)
    code, out, err = eitbench("compare", one, other)
    assert (code, err) == (0, "")
    assert " equal" in out
    baseline = other / "samples.parquet"
    code, out, _ = eitbench("gate", one, "--baseline", baseline)
    assert (code, out.splitlines()[-1].split(":")[0]) == (0, "Gate passed")
    code, out, _ = eitbench("gate", one, "--baseline", baseline, "--margin", "CRPS=0")
    assert code == 0
    assert "CRPS" in out

    table = pd.read_parquet(baseline)
    table.assign(score=table["score"] + 1).to_parquet(baseline)
    code, out, _ = eitbench("gate", one, "--baseline", baseline, "--margin", "score=0.5")
    assert (code, out.splitlines()[-1].split(" of ")[0]) == (1, "Gate failed: 1")
    assert eitbench("gate", one, "--baseline", baseline, "--margin", "score=2")[0] == 0
    code, out, _ = eitbench("compare", one, other, "--json", "--figures", "score,rie")
    verdicts = [change["verdict"] for change in json.loads(out)["changes"]]
    assert verdicts == ["better", "equal"]

    code, out, _ = eitbench("rescore", other)
    assert code == 0
    assert out.splitlines()[0] == "tiny  noser  12 of 12 changed: score"
    assert json.loads(eitbench("gate", one, "--baseline", other, "--json")[1])["passed"]
    manifest = one / "manifest.json"
    manifest.write_text(manifest.read_text()[:1000])
    code, _, err = eitbench("gate", one, "--baseline", other)
    assert code == 1
    assert "manifest.json" in err


@pytest.mark.slow
def test_the_claims_are_evaluated_on_runs_that_are_given(
    stored: Path, tmp_path: Path, eitbench: Run
) -> None:
    folder = tmp_path / "claims"
    code, out, err = eitbench("reproduce", "--runs", stored, "--out", folder)
    assert (code, err) == (0, "")
    found = json.loads((folder / "claims.json").read_text())
    # The suite is another than the paper's: only the packaged learning curves say something.
    tested = {claim["id"] for claim in found["claims"] if claim["verdict"] != "not testable"}
    assert tested == {"data-loss", "physical-loss"}
    assert all(claim["id"] in out for claim in found["claims"])
    for form in ("md", "json", "html"):
        assert str(folder / f"claims.{form}") in out
    assert sorted(path.name for path in folder.iterdir()) == [
        "architecture-phydnn.pdf", "architecture-phydnn.png",
        "architecture-surrogate.pdf", "architecture-surrogate.png",
        "claims.html", "claims.json", "claims.md", "losses.pdf", "losses.png",
    ]  # fmt: skip


@pytest.mark.slow
def test_what_the_claims_need_is_run(
    tmp_path: Path, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = runner.make_plan(load_suite(TINY), limit=2)
    monkeypatch.setattr(reproduce, "_plans", lambda limit: [plan])
    code, out, _ = eitbench("reproduce", "--limit", "2", "--out", tmp_path / "all")
    assert code == 0
    assert "not testable" in out
    for name in ("claims.md", "tiny/manifest.json", "tiny/leaderboard.md", "tiny/figures"):
        assert (tmp_path / "all" / name).exists()


READS_A_SECRET = """
import os, socket
from pathlib import Path
from eitbench.methods import methods, register

HELD = []
for name, way in (
    ("secret", lambda: Path(__file__).with_name("secret").read_text()),
    ("network", lambda: socket.create_connection(("127.0.0.1", int(os.environ["PORT"])), 10)),
):
    try:
        way()
    except OSError:
        HELD.append(name)

@register("reads-a-secret")
class ReadsASecret(methods()["noser"]):
    def fit(self, problem):
        super().fit(problem)
        self.differs = "+".join(HELD)
"""


@pytest.mark.slow
def test_an_isolated_plugin_has_no_network_and_reads_no_files_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, eitbench: Run
) -> None:
    try:
        check_isolation()
    except InputError as error:
        pytest.skip(str(error))
    plugin, run = tmp_path / "plugin.py", tmp_path / "run"
    plugin.write_text(READS_A_SECRET)
    (tmp_path / "secret").write_text("secret")
    choices = (TINY, "--plugin", plugin, "--methods", "reads-a-secret", "--limit", "1")
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setenv("PORT", str(server.getsockname()[1]))
        code, _, err = eitbench("run", *choices, "--isolate", "--out", run)
    assert code == 0, err
    (row,) = pd.read_parquet(run / "methods.parquet").to_dict("records")
    assert (row["differs"], row["coverage"]) == ("secret+network", 1.0)
    assert json.loads(row["actions"])["read"] == [str(tmp_path / "secret")]


LEARNS_FROM_PRESSES = """
from eitbench.methods import methods, register

@register("learns-from-presses")
class LearnsFromPresses(methods()["noser"]):
    def fit(self, problem):
        super().fit(problem)
        self.differs = f"{len(problem.validation(3))} presses"
"""


@pytest.mark.slow
def test_an_isolated_method_learns_from_recordings_that_were_downloaded(
    recorded_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, eitbench: Run
) -> None:
    """They lie in the cache where nobody set EITBENCH_DATA."""
    try:
        check_isolation()
    except InputError as error:
        pytest.skip(str(error))
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    recorded = recorded_set("ohmc8")
    for file in recorded.files:
        to = cached_folder(recorded) / file.path
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(recorded_data / recorded.repository / file.path, to)
    monkeypatch.delenv("EITBENCH_DATA")
    plugin, suite, run = (tmp_path / name for name in ("plugin.py", "skin.toml", "run"))
    plugin.write_text(LEARNS_FROM_PRESSES)
    suite.write_text(
        'name = "skin"\ntitle = "skin"\nmethods = ["noser"]\ndownload_limit_s = 0.001\nlimit = 2\n'
        '[[scenarios]]\nkind = "recorded"\nname = "skin"\nrecording = "ohmc8"\n'
    )
    choices = (suite, "--plugin", plugin, "--methods", "learns-from-presses")
    code, _, err = eitbench("run", *choices, "--isolate", "--out", run)
    assert code == 0, err
    (row,) = pd.read_parquet(run / "methods.parquet").to_dict("records")
    assert (row["differs"], row["coverage"]) == ("3 presses", 1.0)


def test_what_cannot_be_isolated_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, eitbench: Run
) -> None:
    where = ("--scheduler", "tcp://127.0.0.1:9", "--isolate", "--out", tmp_path / "run")
    monkeypatch.setattr(confinement, "landlock_abi", lambda: 0)
    code, _, err = eitbench("run", TINY, *where)
    assert (code, "needs Linux 6.12 or newer" in err) == (2, True)
    monkeypatch.setattr(executors, "check_isolation", lambda: None)
    monkeypatch.setattr(confinement, "check_isolation", lambda: None)
    code, _, err = eitbench("run", TINY, *where)
    assert (code, "leave out --scheduler" in err) == (2, True)
    assert not (tmp_path / "run").exists()
