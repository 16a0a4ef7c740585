"""Scoring stored images again: the same bits, whatever was done to the table of figures."""

import json
from pathlib import Path

import h5py
import pandas as pd
import pytest

from eitbench.benchmark.analysis.rescore import FIGURES, rescore, rescored
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.rundir.kinds import OPERATOR_RUNS
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.suites.scenario import RecordedScenario
from eitbench.scenarios.suites.suite import Suite


def run_of(suite: Suite, out: Path, *plugins: Path) -> Path:
    methods = ["noser", "toy-one-bad"][: 1 + len(plugins)]
    return start_run(make_plan(suite, methods=methods, plugins=plugins, limit=12), out).path


@pytest.fixture(scope="module")
def toy_run(tmp_path_factory: pytest.TempPathFactory, tiny: Suite, toys: Path) -> Path:
    return run_of(tiny, tmp_path_factory.mktemp("runs") / "toys", toys)


def spoil(run: Path, **columns: float) -> pd.DataFrame:
    """Write wrong figures; the right table."""
    table = pd.read_parquet(run / "samples.parquet")
    table.assign(**columns).to_parquet(run / "samples.parquet")
    return table


@pytest.mark.slow
def test_nothing_changes_where_nothing_was_changed(toy_run: Path) -> None:
    table = pd.read_parquet(toy_run / "samples.parquet")
    cells = rescore(toy_run)
    assert [(cell.method, cell.n, cell.changed) for cell in cells] == [
        ("noser", 5, 0), ("toy-one-bad", 5, 0),
    ]  # fmt: skip
    again = pd.read_parquet(toy_run / "samples.parquet")
    pd.testing.assert_frame_equal(again, table, check_exact=True)


@pytest.mark.slow
def test_edited_figures_are_put_right(toy_run: Path) -> None:
    right = spoil(toy_run, psnr=99.0, cc_undefined=False)
    assert right["cc_undefined"].sum() == 5  # the toy returns constant images, or none
    cells = rescore(toy_run)
    assert [cell.figures for cell in cells] == [("psnr",), ("psnr", "cc_undefined")]
    assert [cell.changed for cell in cells] == [5, 5]
    again = pd.read_parquet(toy_run / "samples.parquet")
    pd.testing.assert_frame_equal(again, right, check_exact=True)
    noted = json.loads((toy_run / "manifest.json").read_text())["rescored"]
    assert set(noted[-1]) == {"time", "versions", "machine", "git_commit"}


@pytest.mark.slow
def test_recorded_sets_are_scored_with_the_registration_of_the_run(
    tmp_path: Path, recorded_data: Path
) -> None:
    names = ("ohmc16", "ktc2023", "hydrogel-two-probes")
    sets = (RecordedScenario(name=name, recording=name) for name in names)
    suite = Suite(name="skin", title="", methods=("noser",), scenarios=tuple(sets))
    run = run_of(suite, tmp_path / "run")
    right = spoil(run, **dict.fromkeys(FIGURES, 0.5))
    assert sum(cell.changed for cell in rescore(run)) == 12 + 3 + 12  # the last is of two contacts
    again = pd.read_parquet(run / "samples.parquet")
    pd.testing.assert_frame_equal(again, right, check_exact=True)


@pytest.mark.slow
def test_without_images_nothing_is_touched(tmp_path: Path, tiny: Suite) -> None:
    run = run_of(tiny, tmp_path / "run")
    with h5py.File(run / "reconstructions.h5", "a") as file:
        del file["tiny/noser"]
    before = (run / "samples.parquet").read_bytes()
    with pytest.raises(DataCorruptError, match="'noser'"):
        rescore(run)
    (run / "reconstructions.h5").unlink()
    with pytest.raises(DataCorruptError, match=r"reconstructions\.h5"):
        rescore(run)
    assert (run / "samples.parquet").read_bytes() == before


def test_operators_have_no_images(tmp_path: Path) -> None:
    run = Run(tmp_path, OPERATOR_RUNS, {}, pd.DataFrame(), pd.DataFrame(), {})
    with pytest.raises(InputError, match="operators"):
        next(rescored(run))
