"""Studies: every combination is trained once and scored, also after an interruption."""

import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from tests.support.waiting import has_ended, wait_for

from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.studies import training_study as module
from eitbench.benchmark.studies.training_study import (
    BETAS,
    STUDIES,
    StudyBudget,
    run_study,
)
from eitbench.methods.learned.image_networks import ImageNetworkMethod
from eitbench.methods.training import (
    DivergedError,
    TrainingInterruptedError,
    TrainingRequest,
    train,
)
from eitbench.methods.training.job import TrainingResult
from eitbench.scenarios.errors import InputError

SUITE = """
name = "tiny"
title = "tiny"
methods = ["noser"]

[[scenarios]]
kind = "simulated"
name = "tiny"
sensor = "foam16"
image_shape = [12, 12]
families = ["circle"]
noise = { train = "mixture", validation = "mixture" }
train = 130
validation = 8
test = 6
"""


@pytest.fixture
def budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StudyBudget:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    slow = replace(ImageNetworkMethod.recipe, rate=1e-4)  # so that the last epoch is the best
    monkeypatch.setattr(ImageNetworkMethod, "recipe", slow)
    path = tmp_path / "tiny.toml"
    path.write_text(SUITE)
    return StudyBudget(str(path), epochs=2, operator="jacobian")


def smaller(monkeypatch: pytest.MonkeyPatch, name: str, **grid: tuple[object, ...]) -> None:
    monkeypatch.setitem(STUDIES, name, replace(STUDIES[name], grid=grid))


@pytest.mark.slow
def test_a_study_goes_on_where_it_stopped_and_to_the_same_figures(
    budget: StudyBudget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smaller(monkeypatch, "beta", beta=(0.0001, 1.0))
    trained: list[float | None] = []

    def stopping(request: TrainingRequest) -> TrainingResult:
        trained.append(request.beta)
        if len(trained) == 2:
            raise KeyboardInterrupt
        return train(request)

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(module, "train", stopping)
        with pytest.raises(TrainingInterruptedError):
            run_study("beta", budget, out)
        table = run_study("beta", budget, out)
    assert trained == [0.0001, 1.0, 1.0]  # the one that was finished is not trained again
    pd.testing.assert_frame_equal(table, pd.read_parquet(out / SAMPLES))
    whole = run_study("beta", budget, tmp_path / "whole")
    columns = ["beta", "scenario", "sample", "ssim", "cc", "rie", "psnr", "score"]
    pd.testing.assert_frame_equal(table[columns], whole[columns])
    assert table.groupby("beta").size().to_dict() == {0.0001: 8, 1.0: 8}
    assert table.groupby("beta")["psnr"].mean().nunique() == 2
    assert not list(out.rglob("*.safetensors"))  # hundreds of megabytes in a study of full size
    assert len(list(out.rglob("curve.csv"))) == 2
    with pytest.raises(InputError, match="epochs 2, not 3"):
        run_study("beta", replace(budget, epochs=3), out)


# Processes of its own load PyTorch anew.
@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_losses_are_compared_on_the_same_samples_for_every_seed(
    jobs: int, budget: StudyBudget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smaller(monkeypatch, "physics", physics=("none", "jacobian"), seed=(0, 1))
    table = run_study("physics", replace(budget, epochs=1, scored=5), tmp_path / "out", jobs=jobs)
    found = table.pivot_table(index="sample", columns=["physics", "seed"], values="psnr")
    assert found.shape == (5, 4)
    assert found.notna().all().all()
    assert np.ptp(found.to_numpy(), axis=1).min() > 0


@pytest.mark.slow
def test_a_training_that_diverges_is_a_row_without_figures(
    budget: StudyBudget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smaller(monkeypatch, "size", samples=(128, 130), backbone=("mlp",))

    def diverging(request: TrainingRequest) -> TrainingResult:
        if request.limit == 128:
            raise DivergedError("A loss is not finite.")
        return train(request)

    monkeypatch.setattr(module, "train", diverging)
    table = run_study("size", budget, tmp_path / "out")
    lost = table[table["samples"] == 128]
    assert len(lost) == 1
    assert lost["psnr"].isna().all()
    assert table[table["samples"] == 130]["psnr"].notna().all()


def test_the_published_sweep_is_the_grid() -> None:
    assert len(set(BETAS)) == 52
    assert (BETAS[0], BETAS[-1]) == (1e-4, 0.5)


def test_what_is_no_study_is_refused(budget: StudyBudget, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Unknown study 'betta': did you mean 'beta'"):
        run_study("betta", budget, tmp_path / "out")
    with pytest.raises(
        InputError, match="'size' chooses the numbers of samples itself: leave out --limit"
    ):
        run_study("size", replace(budget, limit=40), tmp_path / "out")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "something").write_text("mine")
    with pytest.raises(InputError, match="is not empty and holds no study"):
        run_study("beta", budget, tmp_path / "full")


@pytest.mark.slow
def test_a_study_that_is_terminated_leaves_no_process(budget: StudyBudget, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [
        "study",
        "beta",
        "--suite",
        budget.suite,
        "--epochs",
        "100000",
        "--operator",
        "jacobian",
    ]
    command = [sys.executable, "-m", "eitbench.cli", *words, "--jobs", "2", "--out", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as study:
        wait_for(lambda: len(list(out.glob("*/curve.csv"))) == 2)
        workers = [child.pid for child in psutil.Process(study.pid).children(recursive=True)]
        study.terminate()
        _, said = study.communicate(timeout=60)
    assert study.returncode != 0
    assert "the same command continues" in said
    for pid in workers:
        wait_for(partial(has_ended, pid))


def test_a_study_that_is_refused_leaves_its_folder_to_another(
    budget: StudyBudget, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> pd.DataFrame:
        raise InputError("100 training samples are too few.")

    monkeypatch.setattr(module, "_rows", refused)
    for limit in (100, 128):
        with pytest.raises(InputError, match="are too few"):
            run_study("beta", replace(budget, limit=limit), tmp_path / "study")
