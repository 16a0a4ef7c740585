"""Inputs of a run and failures around it: names, plugins, recorded sets, signals."""

import json
import signal
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import psutil
import pytest
from tests.support.waiting import wait_for

from eitbench.benchmark.run import method_cell
from eitbench.benchmark.run.runner import RunResult, make_plan, resume_run, start_run
from eitbench.benchmark.rundir.plan import read_resumable
from eitbench.benchmark.workers import restarting
from eitbench.benchmark.workers.worker import Worker
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError, InputError
from eitbench.scenarios.suites.scenario import RecordedScenario, Split
from eitbench.scenarios.suites.suite import Suite

N = 5


@pytest.mark.parametrize(
    ("choice", "sentence"),
    [
        ({"methods": ["nosr"]}, "Unknown method 'nosr': did you mean 'noser'"),
        ({"scenarios": ["tinny"]}, "in suite 'tiny': 'tinny': did you mean 'tiny'"),
        ({"plugins": [Path("no-such.py")]}, "a Python file that exists"),
    ],
)
def test_unknown_names_suggest_the_nearest(
    choice: dict[str, Any], sentence: str, tiny: Suite
) -> None:
    with pytest.raises(InputError, match=sentence):
        make_plan(tiny, **choice)


def test_methods_of_a_plugin_join_the_suite(tiny: Suite, toys: Path) -> None:
    plan = make_plan(tiny, plugins=[toys, toys])
    assert plan.names[0] == "noser"
    assert "toy-good" in plan.names
    assert len(plan.plugins) == 1
    assert make_plan(tiny, methods=["toy-nan"], plugins=[toys]).names == ("toy-nan",)


@pytest.fixture
def with_skin(tiny: Suite) -> Suite:
    skin = RecordedScenario(name="skin", recording="ohmc16")
    return tiny.model_copy(update={"scenarios": (*tiny.scenarios, skin), "limit": 3})


def test_positions_are_scored_after_registration(
    with_skin: Suite, tmp_path: Path, data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A made-up press data set: where conductivity falls most is where it was pressed, shifted."""

    def presses(scenario: object, split: Split = "test", **kwargs: object) -> Dataset:
        frames = data.samples[["sample", "x_m", "y_m"]].copy()
        frames["x_m"] += 0.5
        return replace(
            data, scenario="skin", split=split, samples=frames, truth="position", phantoms=()
        )

    monkeypatch.setattr(method_cell, "load", presses)
    monkeypatch.setattr(method_cell, "fetch_recording", lambda *args, **kwargs: tmp_path)
    result = start_run(make_plan(with_skin, scenarios=["skin"]), tmp_path / "run")
    samples = pd.read_parquet(result.path / "samples.parquet")
    assert len(samples) == N
    assert samples["localisation_mm"].median() < 15
    assert samples["score"].isna().all()


@pytest.mark.parametrize(
    ("error", "field"), [(DataUnavailableError, "skipped"), (DataCorruptError, "refused")]
)
def test_data_that_cannot_be_had_cost_their_scenario_only(
    error: type[Exception],
    field: str,
    with_skin: Suite,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fetch(*args: object, **kwargs: object) -> Path:
        raise error("Fetch it.")

    monkeypatch.setattr(method_cell, "fetch_recording", fetch)
    result = start_run(make_plan(with_skin), tmp_path / "run")
    sentences: dict[str, Any] = {field: (f"Scenario 'skin' is {field}: Fetch it.",)}
    assert result == RunResult(tmp_path / "run", **sentences)
    assert resume_run(tmp_path / "run") == result
    assert set(pd.read_parquet(result.path / "samples.parquet")["scenario"]) == {"tiny"}
    with pytest.raises(error, match="Fetch it"):
        start_run(make_plan(with_skin, scenarios=["skin"]), tmp_path / "nothing")
    assert not (tmp_path / "nothing").exists()


VANDAL = """
from eitbench.methods import Method, methods, register

def broken(self, voltages):
    raise RuntimeError("vandalised")

methods()["noser"].reconstruct = broken

@register("vandal")
class Vandal(Method):
    def fit(self, problem): ...
    reconstruct = broken
"""


def test_a_plugin_does_not_change_the_rows_of_others(
    tiny: Suite, toys: Path, tmp_path: Path
) -> None:
    vandal = tmp_path / "vandal.py"
    vandal.write_text(VANDAL)
    plan = make_plan(tiny, methods=["noser", "toy-good", "vandal"], plugins=[vandal, toys])
    run = start_run(plan, tmp_path / "run").path
    samples = pd.read_parquet(run / "samples.parquet")
    assert samples.groupby("method")["status"].agg(set).to_dict() == {
        "noser": {"ok"},
        "toy-good": {"ok"},
        "vandal": {"error"},
    }
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["plan"]["plugins"][0]["names"] == ["vandal"]
    assert read_resumable(run)[1] == plan


def test_two_plugins_may_not_share_a_name(tiny: Suite, toys: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.py"
    copy.write_text(toys.read_text())
    with pytest.raises(InputError, match=r"'toy-.*' .* by .*toy_methods.* and by"):
        make_plan(tiny, plugins=[toys, copy])


def test_an_unexpected_error_costs_its_cell_only(
    tiny: Suite, toys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def worker(*args: Any, **kwargs: Any) -> Any:
        if args[1].method == "toy-good":
            raise RuntimeError("no more processes")
        return Worker(*args, **kwargs)

    monkeypatch.setattr(restarting, "Worker", worker)
    run = start_run(
        make_plan(tiny, methods=["toy-good", "noser"], plugins=[toys]), tmp_path / "run"
    ).path
    samples = pd.read_parquet(run / "samples.parquet")
    assert Counter(samples["message"]) == {"RuntimeError: no more processes": N, "": N}


HANGS = """
import os, time
from eitbench.methods import methods, register

@register("hangs-on-one")
class HangsOnOne(methods()["noser"]):
    def reconstruct(self, voltages):
        if (voltages.max(axis=1) == float(os.environ["HANGS"])).any():
            time.sleep(1000)
        return super().reconstruct(voltages)
"""


@pytest.mark.slow
def test_a_hanging_frame_is_lost_alone(
    tiny: Suite, tmp_path: Path, data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = tmp_path / "plugin.py"
    plugin.write_text(HANGS)
    monkeypatch.setenv("HANGS", repr(float(data.voltages[2].max())))
    suite = tiny.model_copy(update={"frame_limit_s": 3.0})
    plan = make_plan(suite, methods=["hangs-on-one"], plugins=[plugin])
    samples = pd.read_parquet(start_run(plan, tmp_path / "run").path / "samples.parquet")
    assert samples["status"].tolist() == ["ok", "ok", "timeout", "ok", "ok"]


def _text(file: Path) -> str:
    return file.read_text() if file.is_file() else ""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs signals: run on Linux or macOS")
@pytest.mark.parametrize("name", [pytest.param("SIGTERM", marks=pytest.mark.nightly), "SIGKILL"])
def test_a_run_that_is_ended_leaves_no_process(name: str, toys: Path, tmp_path: Path) -> None:
    number = signal.Signals[name]
    suite = tmp_path / "tiny.toml"
    text = toys.with_name("tiny.toml").read_text()
    suite.write_text(text.replace("frame_limit_s = 2.0", "frame_limit_s = 600.0"))
    program = "from eitbench.cli import main; main()"
    command = [sys.executable, "-c", program, "run", str(suite), "--methods", "toy-hangs"]
    run = tmp_path / "run"
    process = subprocess.Popen([*command, "--plugin", str(toys), "--out", str(run)])
    log = run / "logs" / "tiny--toy-hangs.log"
    worker = psutil.Process(int(wait_for(partial(_text, log))))
    processes = [worker, *psutil.Process(process.pid).children(recursive=True)]
    process.send_signal(number)
    assert process.wait(60) == (130 if number == signal.SIGTERM else -signal.SIGKILL)
    _, alive = psutil.wait_procs(processes, timeout=60)
    assert not [p for p in alive if p.status() != psutil.STATUS_ZOMBIE]
    assert (run / ".lock").exists() == (number == signal.SIGKILL)
