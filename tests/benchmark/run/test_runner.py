"""A run: misbehaviour is a row, rows survive, a resumed run equals an uninterrupted one."""

import errno
import json
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.analysis.results import failures_with_traces, read_run
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.metrics.specs import METRIC_COLUMNS
from eitbench.benchmark.run import cell, method_cell, runner
from eitbench.benchmark.run import executors as execution
from eitbench.benchmark.run.cell_task import CellData, CellPlan
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.run.progress import Advance, RunProgress
from eitbench.benchmark.run.runner import Plan, RunResult, make_plan, resume_run, start_run
from eitbench.benchmark.rundir import lock
from eitbench.benchmark.rundir import plan as plan_module
from eitbench.benchmark.rundir.store import RunStore
from eitbench.methods import methods
from eitbench.reports.tables.boards import notes
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.suites.suite import Suite

N = 5
SameResults = Callable[[Path, Path], None]


@pytest.fixture(scope="module")
def toy_run(
    tiny: Suite, toys: Path, data: Dataset, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """One run of every toy method, two cells at a time."""
    out = tmp_path_factory.mktemp("runs") / "toys"
    largest = np.sort(data.voltages.max(axis=1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOY_LIMIT", repr(float(largest[-2:].mean())))
        patch.setenv("TOY_FIRST", repr(float(data.voltages[0].max())))
        return start_run(make_plan(tiny, plugins=[toys]), out, jobs=2).path


@pytest.fixture(scope="module")
def samples(toy_run: Path) -> pd.DataFrame:
    return pd.read_parquet(toy_run / "samples.parquet")


@pytest.fixture(scope="module")
def table(toy_run: Path) -> pd.DataFrame:
    return pd.read_parquet(toy_run / "methods.parquet").set_index("method")


@pytest.mark.parametrize(
    ("method", "statuses", "message"),
    [
        ("noser", {"ok": N}, ""),
        ("toy-good", {"ok": N}, ""),
        ("toy-raises", {"error": N}, "RuntimeError: the sky is falling"),
        ("toy-fit-raises", {"error": N}, "ValueError: no licence for this sensor"),
        ("toy-nan", {"ok": N - 1, "invalid-output": 1}, "not finite"),
        ("toy-wild", {"ok": N - 1, "invalid-output": 1}, "returned values beyond 1000 S/m"),
        ("toy-masked", {"invalid-output": N}, "not finite"),
        ("toy-shape", {"invalid-output": N}, "shape (5, 1600) instead of (5, 40, 40)"),
        ("toy-complex", {"invalid-output": N}, "complex128 instead of real numbers"),
        ("toy-ragged", {"invalid-output": N}, "a list that is not an array"),
        ("toy-prints", {"ok": N}, ""),
        ("toy-hangs", {"timeout": N}, "took longer than 2 s"),
        ("toy-mutates", {"error": N}, "changed its input in place"),
        ("toy-killed", {"ok": N}, ""),  # single frames fit
        ("toy-dies-on-one", {"ok": N - 1, "error": 1}, "exit code 5"),
        ("toy-dies-on-first", {"ok": N - 1, "error": 1}, "exit code 5"),
        ("toy-strange-error", {"error": N}, "ValueError: \\ud800xxx"),
        ("toy-memory", {"ok": N}, ""),  # single frames fit
        ("toy-no-memory", {"out-of-memory": N}, "MemoryError: image too large"),
        ("toy-exits", {"error": N}, "exit code 3"),
        ("toy-one-bad", {"ok": N - 1, "error": 1}, "ArithmeticError: this frame diverges"),
        ("toy-random", {"ok": N}, ""),
    ],
)
def test_a_method_costs_its_own_rows_only(
    method: str,
    statuses: dict[str, int],
    message: str,
    samples: pd.DataFrame,
    table: pd.DataFrame,
    data: Dataset,
) -> None:
    rows = samples[samples["method"] == method]
    assert rows["sample"].tolist() == list(range(N))
    assert rows["input_hash"].tolist() == data.frame_hashes
    assert Counter(rows["status"]) == statuses
    bad = rows[rows["status"] != "ok"]
    assert all(message in text for text in bad["message"])
    assert (rows.loc[rows["status"] == "ok", "message"] == "").all()
    background = evaluate(data, np.full((N, *data.sensor.image_shape), data.sensor.background))
    figures = list(METRIC_COLUMNS)
    pd.testing.assert_frame_equal(
        bad.set_index("sample")[figures], background.loc[bad["sample"], figures], check_names=False
    )
    assert rows["score"].notna().all()
    assert table.loc[method, "n"] == N
    assert table.loc[method, "coverage"] == statuses.get("ok", 0) / N


def test_a_method_that_cannot_be_fitted_keeps_its_source(table: pd.DataFrame) -> None:
    assert table.loc["toy-fit-raises", "source"] == (
        "A. Author, Fits that fail, 2024,\ndoi:10.1000/182"
    )
    assert table.loc["noser", "source"] == methods()["noser"].source


def test_what_a_method_prints_goes_to_its_log(toy_run: Path) -> None:
    text = (toy_run / "logs" / "tiny--toy-prints.log").read_text()
    assert "hello from the plugin" in text
    assert "hello from the system" in text


def test_an_exception_of_a_method_shows_where_it_was_raised(
    toy_run: Path, table: pd.DataFrame
) -> None:
    trace = str(table.loc["toy-fit-raises", "trace"])
    where = 'toy_methods.py", line 36, in fit'
    assert trace.split("\n")[0].endswith(where)
    assert "raise ValueError" in trace
    assert "eitbench" not in trace  # none of its callers
    log = (toy_run / "logs" / "tiny--toy-fit-raises.log").read_text()
    assert where in log
    assert log.count("ValueError: no licence for this sensor") == 1
    assert table.loc[["noser", "toy-nan"], "trace"].tolist() == ["", ""]
    ((sentence, told),) = (
        found for found in failures_with_traces(read_run(toy_run)) if "toy-fit-raises" in found[0]
    )
    assert sentence.endswith("ValueError: no licence for this sensor")
    assert told == trace


def test_scoring_the_stored_images_again_gives_the_same_bits(
    toy_run: Path, samples: pd.DataFrame, data: Dataset
) -> None:
    with h5py.File(toy_run / "reconstructions.h5") as file:
        truth = file["tiny/truth"]
        np.testing.assert_array_equal(truth["conductivity"][:], data.conductivity)
        np.testing.assert_array_equal(truth["mask"][:], data.sensor.mask)
        assert truth.attrs["background"] == 1.0
        assert truth.attrs["data_range"] == 1.0
        assert truth.attrs["bounds"].tolist() == [0.0, 0.0, 0.1, 0.1]
        for method, rows in samples.groupby("method"):
            images = file[f"tiny/{method}/conductivity"][:]
            assert images.dtype == np.float32
            assert file[f"tiny/{method}/sample"][:].tolist() == list(range(N))
            bad = (rows["status"] != "ok").to_numpy()
            np.testing.assert_array_equal(np.isnan(images).all(axis=(1, 2)), bad)
            again = evaluate(data, images)
            for metric in METRIC_COLUMNS:
                np.testing.assert_array_equal(again[metric], rows[metric])


def test_times_are_told_apart(table: pd.DataFrame) -> None:
    good = table.loc["toy-slow"]
    assert good["setup_s"] > 0
    assert good["first_frame_ms"] > 20
    assert good["frame_ms_p50"] > 20
    assert np.isnan(good["frame_ms_p99"])  # of one frame
    assert 0 < good["batch_fps"] < 50
    assert good["memory_mb"] > 10
    assert np.isnan(good["train_s"])
    assert table["frame_ms_p50"].isna()["toy-raises"]
    assert table["frame_ms_p50"].notna()["toy-dies-on-one"]
    assert table["first_frame_ms"].isna()["toy-dies-on-first"]
    assert json.loads(str(table.loc["noser", "parameters"]))["weight"] > 0


def test_the_manifest_tells_the_whole_story(toy_run: Path, data: Dataset, tiny: Suite) -> None:
    manifest = json.loads((toy_run / "manifest.json").read_text())
    assert manifest["status"] == "finished"
    assert manifest["finished"] >= manifest["started"]
    assert manifest["data"]["tiny"]["hash"] == data.data_hash
    assert manifest["data"]["tiny"]["inverse_crime"] is True
    assert manifest["threads"] == 1
    assert manifest["jobs"] == 2
    assert manifest["seeds"]
    assert manifest["calibration_ms"] > 0
    assert Suite.model_validate(manifest["plan"]["suite"]) == tiny
    assert manifest["cells"][0]["track"] == "default"
    assert manifest["command_line"]
    assert {path.name for path in toy_run.iterdir()} == {
        "logs", "manifest.json", "methods.parquet", "plugins", "reconstructions.h5",
        "samples.parquet",
    }  # fmt: skip


def plan_of(suite: Suite, toys: Path, *methods: str) -> Plan:
    return make_plan(suite, methods=methods, plugins=[toys])


def fill_disk_after(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `count` batches be written and refuse the next."""
    save = np.savez
    written: list[Path] = []

    def savez(path: Path, **arrays: Any) -> None:
        if len(written) == count:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(path)
        save(path, **arrays)

    monkeypatch.setattr(np, "savez", savez)


@pytest.mark.slow
def test_a_full_disk_keeps_what_was_finished_and_resumes(
    same_results: SameResults,
    tiny: Suite,
    toys: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = plan_of(tiny, toys, "noser", "toy-random", "toy-nan")
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    with monkeypatch.context() as patch:
        # Resuming must keep to the batches of the start, whatever is usual by then.
        patch.setattr(MethodData, "batch", 2)
        start_run(plan, whole)
        fill_disk_after(4, patch)  # the first cell whole, the second in its middle
        with pytest.raises(EitbenchError, match=r"No space left.*eitbench run --resume .*cut"):
            start_run(plan, cut)
    kept = sorted(path.name for path in (cut / "parts").rglob("test-*.npz"))
    assert len(kept) == 4
    result = resume_run(cut)
    assert result == RunResult(cut, ())
    same_results(whole, cut)
    manifest = json.loads((cut / "manifest.json").read_text())
    assert len(manifest["resumed"]) == 1
    assert resume_run(cut, suite=tiny).path == cut  # nothing left to do


def test_frames_that_are_stored_on_the_way_are_counted(
    tiny: Suite, toys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose batch fails is asked frame by frame, and its rows are stored as they come."""
    monkeypatch.setattr(cell, "SAVE_SECONDS", -1.0)
    progress, counted = RunProgress(quiet=True), list[int]()

    @contextmanager
    def counting(name: str, frames: int) -> Iterator[Advance]:
        assert frames == N
        yield counted.append

    monkeypatch.setattr(progress, "cell", counting)
    start_run(plan_of(tiny, toys, "toy-memory"), tmp_path / "run", progress=progress)
    assert sum(counted) == N


def test_a_run_that_was_killed_before_its_plugins_were_kept_keeps_them(cut_run: Path) -> None:
    kept = [*(cut_run / "plugins").iterdir()]
    texts = [path.read_text() for path in kept]
    shutil.rmtree(cut_run / "plugins")
    resume_run(cut_run)
    assert [path.read_text() for path in kept] == texts


@pytest.mark.slow
def test_several_cells_at_a_time_change_nothing(
    same_results: SameResults, tiny: Suite, toys: Path, tmp_path: Path
) -> None:
    plan = plan_of(tiny, toys, "noser", "toy-random", "toy-good")
    start_run(plan, tmp_path / "one", jobs=1)
    start_run(plan, tmp_path / "three", jobs=3)
    same_results(tmp_path / "one", tmp_path / "three")


@pytest.fixture
def cut_run(tiny: Suite, toys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run that stopped before its first batch, of a plugin of its own."""
    plugin = tmp_path / "plugin.py"
    plugin.write_text(toys.read_text())
    with monkeypatch.context() as patch:
        fill_disk_after(0, patch)
        with pytest.raises(EitbenchError):
            start_run(make_plan(tiny, methods=["toy-good"], plugins=[plugin]), tmp_path / "cut")
    return tmp_path / "cut"


def test_resuming_needs_a_run_of_the_same_suite_data_and_plugin(
    cut_run: Path, tiny: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="is not a run directory"):
        resume_run(tmp_path)
    other = tiny.model_copy(update={"frame_limit_s": 3.0})
    with pytest.raises(InputError, match="was started with suite 'tiny' as it was then"):
        resume_run(cut_run, suite=other)
    with monkeypatch.context() as patch:
        changed = replace(load(tiny.scenarios[0]), data_hash="0" * 64)
        patch.setattr(method_cell, "load", lambda *args, **kwargs: changed)
        with pytest.raises(InputError, match="the data of scenario 'tiny' have changed"):
            resume_run(cut_run)
    plugin = cut_run.parent / "plugin.py"
    plugin.write_text(plugin.read_text() + "\n# changed\n")
    with pytest.raises(InputError, match=r"the plugin .*plugin\.py has changed"):
        resume_run(cut_run)


def test_resuming_needs_the_installed_methods_and_the_libraries_of_the_start(
    cut_run: Path, tiny: Suite, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(plan_module, "source_hash", lambda cls: "ab" * 32)
        assert make_plan(tiny, methods=["noser"]).installed == {"noser": "ab" * 32}
    assert make_plan(tiny, methods=["noser"]).installed == {}  # one of ours
    path = cut_run / "manifest.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps({**manifest, "versions": {**manifest["versions"], "numpy": "1.0"}}))
    with pytest.raises(InputError, match=r"it was started with numpy 1\.0, and"):
        resume_run(cut_run)
    changed = {**manifest["plan"], "installed": {"noser": "ab" * 32}}
    path.write_text(json.dumps({**manifest, "plan": changed}))
    with pytest.raises(InputError, match="file of the installed method 'noser' has changed"):
        resume_run(cut_run)


def test_a_resumption_that_is_killed_is_noted(
    cut_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its rows may be of other code than the first ones."""

    def killed(*_: object) -> None:
        raise SystemExit(9)

    with monkeypatch.context() as patch:
        patch.setattr(runner, "_execute", killed)
        with pytest.raises(SystemExit):
            resume_run(cut_run)
    path = cut_run / "manifest.json"
    assert len(json.loads(path.read_text())["resumed"]) == 1
    resume_run(cut_run)
    assert len(json.loads(path.read_text())["resumed"]) == 2


def test_a_run_in_use_is_not_resumed(cut_run: Path) -> None:
    with (
        lock.locked(cut_run),
        pytest.raises(InputError, match="Another process is working on"),
    ):
        resume_run(cut_run)
    assert resume_run(cut_run).path == cut_run
    assert not list(cut_run.glob(".lock*"))


HOLDER = """
import sys, time
from pathlib import Path
from eitbench.benchmark.rundir.lock import locked
with locked(Path(sys.argv[1])):
    print("holds it", flush=True)
    time.sleep(1000)
"""


@pytest.mark.slow
@pytest.mark.parametrize("apart", [False, True])
def test_a_lock_holds_as_long_as_its_process(cut_run: Path, apart: bool) -> None:
    """Also of one whose number nobody here knows, as in another container or on another machine."""
    own = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child"]
    if apart and subprocess.run([*own, "true"], capture_output=True).returncode:
        pytest.skip("needs a namespace of process numbers: run as root on Linux")
    command = [*(own if apart else ()), sys.executable, "-c", HOLDER, str(cut_run)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(InputError, match="Another process is working on"):
            resume_run(cut_run)
        # Killed, and nobody has asked yet how it ended.
        holder.kill()
        holder.stdout.read()
        assert (cut_run / ".lock").exists()
        assert resume_run(cut_run).path == cut_run
    assert not list(cut_run.glob(".lock*"))


@pytest.mark.slow
def test_a_run_is_finished_only_with_every_cell(
    tiny: Suite, toys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_cell = cell.run_cell

    def forget(task: Any, *args: Any, **options: Any) -> None:
        if task.plan.cell.name != "toy-good":
            run_cell(task, *args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(execution, "run_cell", forget)
        with pytest.raises(EitbenchError, match=r"1 of 2 cells .* is not finished"):
            start_run(plan_of(tiny, toys, "noser", "toy-good"), tmp_path / "run")
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert manifest["status"] == "interrupted"
    resume_run(tmp_path / "run")
    assert len(pd.read_parquet(tmp_path / "run" / "samples.parquet")) == 2 * N


def test_resuming_refuses_an_incomplete_manifest(cut_run: Path) -> None:
    manifest = json.loads((cut_run / "manifest.json").read_text())
    for name in ("batch", "resumed", "refused"):
        part = {key: value for key, value in manifest.items() if key != name}
        (cut_run / "manifest.json").write_text(json.dumps(part))
        with pytest.raises(InputError, match=f"incomplete \\('{name}'\\)"):
            resume_run(cut_run)


def test_what_lacks_weights_for_a_sensor_is_left_out_and_said(tiny: Suite, tmp_path: Path) -> None:
    result = start_run(make_plan(tiny, methods=["noser", "dnn"]), tmp_path / "run")
    (sentence,) = result.skipped
    assert sentence.startswith("Scenario 'tiny' is left out for 'dnn': 'dnn' has no weights for")
    assert "`eitbench train dnn --suite SUITE`" in sentence
    assert set(pd.read_parquet(result.path / "samples.parquet")["method"]) == {"noser"}
    assert resume_run(result.path).skipped == result.skipped
    with pytest.raises(InputError, match="is left out for 'dnn'"):
        start_run(make_plan(tiny, methods=["dnn"]), tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_slow_method_gets_the_first_samples_alone(tiny: Suite, tmp_path: Path) -> None:
    suite = tiny.model_copy(update={"first": {"noser": 2}})
    run = start_run(make_plan(suite, methods=["noser", "tikhonov"]), tmp_path / "run").path
    alone = start_run(make_plan(tiny, methods=["noser"]), tmp_path / "alone").path
    one, other = (pd.read_parquet(path / "samples.parquet") for path in (run, alone))
    of = one["method"] == "noser"
    assert one[of]["sample"].tolist() == [0, 1]
    assert one[~of]["sample"].tolist() == [*range(N)]
    assert one[of]["psnr"].tolist() == other["psnr"][:2].tolist()
    assert [(cell.method, cell.n, cell.changed) for cell in rescore(run)] == [
        ("noser", 2, 0), ("tikhonov", N, 0),
    ]  # fmt: skip
    rows = {row["method"]: row for row in leaderboard_rows([read_run(run)])}
    assert (rows["tikhonov"]["rank"], rows["noser"]["rank"]) == (1, 2)
    assert rows["noser"]["psnr"] > rows["tikhonov"]["psnr"]  # however good its few
    assert f"noser has 2 of {N} samples" in "; ".join(notes([*rows.values()]))


def test_a_run_goes_on_with_the_weights_it_was_started_with(
    tiny: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end_run: Callable[[int], None]
) -> None:
    save = RunStore.save_batch

    def save_and_end(*arguments: Any) -> None:
        save(*arguments)
        end_run(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(methods()["noser"], "weights_hash", lambda sensor: "those")
        patch.setattr(RunStore, "save_batch", save_and_end)
        with pytest.raises(runner.RunInterruptedError):
            start_run(make_plan(tiny, methods=["noser"]), tmp_path / "run")
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert [entry["weights"] for entry in manifest["cells"]] == ["those"]
    with pytest.raises(InputError, match="the weights of 'noser' have changed"):
        resume_run(tmp_path / "run")


@pytest.mark.parametrize(("jobs", "last"), [(1, "laplacian"), (2, "noser")])
def test_several_at_a_time_begin_with_what_took_longest_to_tune(
    jobs: int, last: str, tiny: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One at a time keep the order that is asked for. What it took may not be known."""
    seconds = {"noser": None, "tikhonov": 20.0, "laplacian": 300.0}
    begun: list[str] = []
    run = execution.Executor.run

    def noting(self: execution.Executor, data: CellData, plan: CellPlan, *given: Any) -> None:
        begun.append(plan.cell.name)
        run(self, data, plan, *given)

    def chosen(self: MethodData, name: str, *_: Any) -> dict[str, Any]:
        return {"parameters": {}, "spent": {"seconds": seconds[name]}, "trials": []}

    monkeypatch.setattr(execution.Executor, "run", noting)
    monkeypatch.setattr(MethodData, "selection", chosen)
    start_run(make_plan(tiny, methods=list(seconds)), tmp_path / "run", jobs=jobs)
    assert begun[-1] == last
    assert sorted(begun) == sorted(seconds)
