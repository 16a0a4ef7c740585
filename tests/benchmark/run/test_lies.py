"""Whatever a plugin says costs its own rows only, and runs no code in the judge."""

import json
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.leaderboard import boards, leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.run import method_cell
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.workers.confinement import landlock_abi
from eitbench.scenarios.suites.suite import Suite

LYING = Path(__file__).parents[1] / "data" / "lying_methods.py"
NO_ANSWER = ("sends-an-object", "sends-a-huge-message")


@pytest.fixture(scope="module")
def run(tiny: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of every method that lies, beside one that does not."""
    folder = tmp_path_factory.mktemp("lies")
    limits = {"limit": 1, "fit_limit_s": 60.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIES", str(folder / "code-was-run"))
        plan = make_plan(tiny.model_copy(update=limits), plugins=[LYING])
        names = [name for name in plan.names if name != "rewrites-others"]
        plan = plan.model_copy(update={"names": tuple(names)})
        patch.setattr(method_cell, "WARM_SECONDS", 0.0)
        return start_run(plan, folder / "run", jobs=2).path


@pytest.fixture(scope="module")
def cells(run: Path) -> pd.DataFrame:
    return pd.read_parquet(run / "methods.parquet").set_index("method")


@pytest.mark.slow
def test_all_others_keep_their_rows(run: Path) -> None:
    """And what they hold can be shown."""
    samples = pd.read_parquet(run / "samples.parquet").set_index("method")
    assert samples["status"].drop(list(NO_ANSWER)).eq("ok").all()
    (board,) = boards(leaderboard_rows([read_run(run)]))
    assert len(board) == len(samples)
    json.dumps(board, ensure_ascii=False).encode()


@pytest.mark.slow
def test_no_code_was_run_in_the_judge(run: Path) -> None:
    assert not (run.parent / "code-was-run").exists()


@pytest.mark.slow
@pytest.mark.parametrize("method", NO_ANSWER)
def test_what_is_no_answer_costs_the_worker(method: str, run: Path) -> None:
    rows = pd.read_parquet(run / "samples.parquet").set_index("method").loc[[method]]
    assert rows["status"].tolist() == ["error"]
    said = "its process sent something that is no answer during set-up"
    assert rows["message"].tolist() == [said]


@pytest.mark.slow
def test_texts_are_short_and_can_be_written(cells: pd.DataFrame) -> None:
    assert cells.loc["surrogates", "differs"] == "\\ud800"
    assert len(str(cells.loc["long-text", "differs"])) == 500
    parameters = json.loads(str(cells.loc["odd-parameters", "parameters"]))
    assert parameters["surrogate"] == "\\ud800"
    assert len(parameters["long"]) == 500


@pytest.mark.slow
@pytest.mark.parametrize("method", ["endless-training", "training-runs-code"])
def test_training_that_cannot_be_is_not_known(method: str, cells: pd.DataFrame) -> None:
    assert cells["overlap"].isna()[method]
    assert cells.loc[method, "prior_knowledge"]


@pytest.mark.slow
def test_columns_that_are_not_a_methods_to_tell_are_not_taken(cells: pd.DataFrame) -> None:
    row = cells.loc["forges-columns"]
    assert row["scenario"] == "tiny"
    assert row["n"] == row["coverage"] == 1
    assert cells["train_s"].isna()["surrogates"]
    assert len(cells.loc[["noser"]]) == 1


@pytest.mark.slow
def test_its_images_are_its_own(run: Path) -> None:
    with h5py.File(run / "reconstructions.h5") as file:
        image = file["tiny/noser/conductivity"][0]
        assert len(np.unique(image)) > 10
        assert np.unique(file["tiny/surrogates/conductivity"][0]).size == 1


@pytest.mark.skipif(landlock_abi() < 3, reason="needs Linux 6.2 with Landlock")
def test_rows_of_another_cell_cannot_be_rewritten(tiny: Suite, tmp_path: Path) -> None:
    """A worker cannot write where results are; that it tried is in its own row."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LIES", str(tmp_path / "none"))
        patch.setattr(method_cell, "WARM_SECONDS", 0.0)
        suite = tiny.model_copy(update={"limit": 1})
        plan = make_plan(suite, methods=["noser", "rewrites-others"], plugins=[LYING])
        run = start_run(plan, tmp_path / "run").path
    cells = pd.read_parquet(run / "methods.parquet").set_index("method")
    assert cells.loc["noser", "memory_mb"] != 12345
    assert cells.loc["noser", "coverage"] == 1
    assert cells.loc["noser", "actions"] == ""
    actions = json.loads(str(cells.loc["rewrites-others", "actions"]))
    assert actions["write"] == [str(run / "parts" / "tiny" / "noser" / "methods.parquet")]
