"""A run of operators: figures that can be checked, misbehaviour as rows, resuming."""

import json
import signal
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.run import operator_cell
from eitbench.benchmark.run.operator_cell import OperatorData
from eitbench.benchmark.run.runner import RunInterruptedError, make_plan, resume_run, start_run
from eitbench.benchmark.rundir.plan import read_resumable
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.workers.operator_service import OperatorService
from eitbench.methods import operator
from eitbench.methods.registry import operators
from eitbench.scenarios import guard, sensor
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import clean_frames
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.suites.scenario import RecordedScenario, SimulatedScenario
from eitbench.scenarios.suites.suite import Suite, load_suite

DATA = Path(__file__).parents[1] / "data"
TOYS = DATA / "toy_operators.py"
N = 6
TIMES = [
    "forward_ms", "grad_ms", "setup_s", "first_frame_ms", "batch_fps", "memory_mb",
    "calibration_ms", "calibration_spread", "load", "cpu_mhz", "timed",
]  # fmt: skip


@pytest.fixture(scope="module")
def suite() -> Suite:
    return load_suite(DATA / "tiny-operators.toml")


@pytest.fixture(scope="module", autouse=True)
def quickly() -> Any:
    """Three batches a scenario, and no longer measured than needed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OperatorData, "batch", 2)
        patch.setattr(operator_cell, "WARM_SECONDS", 0.0)
        yield


@pytest.fixture(scope="module")
def run(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The exact operator and the linear one on both scenarios, two cells at a time."""
    plan = make_plan(suite, operators=["fem", "jacobian"])
    return start_run(plan, tmp_path_factory.mktemp("runs") / "good", jobs=2).path


def scenario(suite: Suite, name: str) -> SimulatedScenario:
    (found,) = (s for s in suite.scenarios if s.name == name)
    assert isinstance(found, SimulatedScenario)
    return found


@pytest.mark.parametrize("name", ["tiny-same", "tiny-finer"])
def test_figures_are_what_the_operator_gives(name: str, suite: Suite, run: Path) -> None:
    """Computed again here, in this process, the slow way."""
    of = scenario(suite, name)
    jacobian, model = operator("jacobian", of.nominal_sensor), of.data_model("test")
    assert isinstance(model, ForwardModel)
    sigma = load(of).conductivity
    assert sigma is not None
    clean, untouched = clean_frames(of, "test", N)
    reference = untouched[0]
    known = clean_frames(of, "validation", 8).voltages
    mean, std = known.mean(axis=0), known.std(axis=0)
    voltages = jacobian.voltages(np.array(sigma))
    z, y = (clean - mean) / std, (voltages - mean) / std
    factor = len(model.sensor.mask) // len(of.nominal_sensor.mask)
    cosines = []
    for image, touch, response in zip(sigma, load(of).phantoms, clean - reference, strict=True):
        fine = rasterise(touch, model.sensor)
        finest = np.tensordot(response, model.jacobian(fine), axes=1)
        blocks = [finest[i::factor, j::factor] for i in range(factor) for j in range(factor)]
        exact = np.sum(blocks, axis=0)
        found = jacobian.vjp(np.array(image), np.array(response))
        cosines.append((exact * found).sum() / np.linalg.norm(exact) / np.linalg.norm(found))

    rows = leaderboard_rows([read_run(run)])
    (row,) = (r for r in rows if (r["scenario"], r["operator"]) == (name, "jacobian"))
    relative = np.linalg.norm(voltages - clean, axis=1) / np.linalg.norm(clean, axis=1)
    assert row["mse"] == pytest.approx(np.mean((y - z) ** 2), rel=1e-9)
    responses = (clean - reference).ravel(), (voltages - reference).ravel()
    assert row["r"] == pytest.approx(np.corrcoef(*responses)[0, 1], rel=1e-9)
    assert row["rel_error"] == pytest.approx(relative.mean(), rel=1e-9)
    assert row["grad_cosine"] == pytest.approx(np.mean(cosines), rel=1e-6)
    with h5py.File(run / "voltages.h5") as file:
        np.testing.assert_allclose(file[f"{name}/jacobian/voltages"][:], voltages, rtol=1e-12)
        np.testing.assert_array_equal(file[f"{name}/truth/voltages"][:], clean)
        np.testing.assert_array_equal(file[f"{name}/truth/reference"][:], reference)
        np.testing.assert_array_equal(file[f"{name}/truth/mean"][:], mean)


def test_the_exact_operator_is_exact_on_its_own_mesh_and_discretised_on_a_finer_one(
    run: Path,
) -> None:
    rows = {(r["scenario"], r["operator"]): r for r in leaderboard_rows([read_run(run)])}
    same, finer = rows["tiny-same", "fem"], rows["tiny-finer", "fem"]
    assert same["mse"] < 1e-20
    assert same["r"] == pytest.approx(1, abs=1e-12)
    assert same["grad_cosine"] == pytest.approx(1, abs=1e-12)
    assert same["inverse_crime"] is True
    assert finer["inverse_crime"] is False
    assert 1e-6 < finer["mse"] < rows["tiny-finer", "jacobian"]["mse"]
    for (_, name), row in rows.items():
        assert row["rank"] == {"fem": 1, "jacobian": 2}[name]
        assert (row["n"], row["coverage"], row["train_s"], row["trained_on"]) == (N, 1.0, 0.0, "")
        assert min(row[name] for name in ("forward_ms", "grad_ms", "setup_s")) > 0
        assert row["memory_mb"] > 50


@pytest.mark.slow
def test_a_limit_does_not_change_the_scale(suite: Suite, run: Path, tmp_path: Path) -> None:
    plan = make_plan(suite, scenarios=["tiny-finer"], limit=3)
    part = pd.read_parquet(start_run(plan, tmp_path / "part").path / "samples.parquet")
    whole = pd.read_parquet(run / "samples.parquet")
    of = (whole["scenario"] == "tiny-finer") & (whole["operator"] == "jacobian")
    for name in ("mse", "rel_error", "grad_cosine"):
        np.testing.assert_allclose(part[name], whole[of][name][:3], rtol=1e-9)
    assert part["input_hash"].tolist() == whole[of]["input_hash"][:3].tolist()


def test_every_operator_saw_the_same_images(run: Path) -> None:
    samples = pd.read_parquet(run / "samples.parquet")
    for _, rows in samples.groupby("scenario"):
        hashes = {tuple(of["input_hash"]) for _, of in rows.groupby("operator")}
        assert len(hashes) == 1
        assert len(set(*hashes)) == N
    assert {"suite", "family", "conductivity", "sample", "message"} <= set(samples)
    assert "snr_db" not in samples


def test_the_directory_is_laid_out_like_any_other(run: Path, suite: Suite) -> None:
    assert {path.name for path in run.iterdir()} == {
        "logs", "manifest.json", "operators.parquet", "samples.parquet", "voltages.h5",
    }  # fmt: skip
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["status"] == "finished"
    assert {entry["name"] for entry in manifest["cells"]} == {"fem", "jacobian"}
    assert manifest["versions"]["torch"]
    assert read_resumable(run)[1] == make_plan(suite, operators=["fem", "jacobian"])


@pytest.fixture(scope="module")
def toys(suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    image = load(scenario(suite, "tiny-same")).conductivity
    assert image is not None
    names = [
        "toy-flat",
        "toy-set-up",
        "toy-cheats",
        "toy-shape",
        "toy-nan",
        "toy-raises",
        "toy-mutates",
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOY_MEAN", repr(float(image[3].mean())))
        plan = make_plan(suite, operators=names, scenarios=["tiny-same"], plugins=[TOYS])
        out = start_run(plan, tmp_path_factory.mktemp("runs") / "toys", jobs=2).path
    rows = pd.DataFrame(leaderboard_rows([read_run(out)])).set_index("operator")
    samples = pd.read_parquet(out / "samples.parquet")
    return samples.join(rows[["rank", "r", "train_s", "trained_on"]], on="operator")


def test_the_test_split_is_closed_before_the_file_of_an_operator_is_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(guard, "_closed", 0)
    file = tmp_path / "empty.py"
    file.write_text("from eitbench.scenarios.guard import is_closed\nassert is_closed()\n1 / 0\n")
    with pytest.raises(InputError, match="ZeroDivisionError"):
        OperatorService(sensor("foam16"), "fem", file).set_up()
    assert guard.is_closed()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "statuses", "message"),
    [
        ("toy-flat", {"ok": N}, ""),
        ("toy-set-up", {"error": N}, "RuntimeError: no weights for this sensor"),
        ("toy-cheats", {"error": N}, "The test split is closed to methods"),
        ("toy-shape", {"invalid-output": N}, "shape (2, 207) instead of (2, 208)"),
        ("toy-nan", {"ok": N - 1, "invalid-output": 1}, "not finite"),
        ("toy-raises", {"ok": N - 1, "error": 1}, "ArithmeticError: this image diverges"),
        ("toy-mutates", {"error": N}, "changed its input in place"),
    ],
)
def test_an_operator_costs_its_own_rows_only(
    name: str, statuses: dict[str, int], message: str, toys: pd.DataFrame
) -> None:
    rows = toys[toys["operator"] == name]
    assert rows["sample"].tolist() == list(range(N))
    assert Counter(rows["status"]) == statuses
    bad = rows[rows["status"] != "ok"]
    assert all(message in text for text in bad["message"])
    assert bad[["mse", "rel_error", "grad_cosine"]].isna().all(axis=None)
    assert rows.loc[rows["status"] == "ok", ["mse", "grad_cosine"]].notna().all(axis=None)
    if "ok" in statuses and len(bad):
        assert bad["sample"].tolist() == [3]


@pytest.mark.slow
def test_a_gradient_of_zero_has_no_direction(toys: pd.DataFrame) -> None:
    rows = toys[toys["operator"] == "toy-flat"]
    assert rows["grad_undefined"].all()
    assert (rows["grad_cosine"] == 0).all()
    assert rows["rank"].unique().tolist() == [1]
    assert set(rows["train_s"]) == {3600.0}
    assert set(rows["trained_on"]) == {"a big machine"}


@pytest.mark.slow
def test_a_terminated_run_resumes_to_the_same_figures(
    suite: Suite,
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    end_run: Callable[[int], None],
) -> None:
    """Ended by SIGTERM: once among the model's own gradients, once amid an operator."""
    cut, save, saved = tmp_path / "cut", RunStore.save_batch, []

    def save_and_end(store: RunStore, cell: Any, *arguments: Any) -> None:
        save(store, cell, *arguments)
        saved.append(cell.name)
        if len(saved) in (2, 5):
            end_run(signal.SIGTERM)

    plan = make_plan(suite, operators=["fem"], scenarios=["tiny-finer"])
    with monkeypatch.context() as patch:
        patch.setattr(RunStore, "save_batch", save_and_end)
        with pytest.raises(RunInterruptedError, match=r"eitbench run --resume .*cut"):
            start_run(plan, cut)
        with pytest.raises(RunInterruptedError):
            resume_run(cut)
    assert set(saved) == {"truth", "fem"}
    with monkeypatch.context() as patch:
        patch.setattr(operators()["fem"], "weights_hash", lambda sensor: "others")
        with pytest.raises(InputError, match="weights of 'fem' have changed"):
            resume_run(cut)
    assert resume_run(cut).path == cut
    for table in ("samples.parquet", "operators.parquet"):
        resumed, whole = (pd.read_parquet(path / table) for path in (cut, run))
        whole = whole[(whole["scenario"] == "tiny-finer") & (whole["operator"] == "fem")]
        assert resumed["forward_ms"].notna().all()
        pd.testing.assert_frame_equal(
            resumed.drop(columns=TIMES, errors="ignore").reset_index(drop=True),
            whole.drop(columns=TIMES, errors="ignore").reset_index(drop=True),
            check_exact=True,
        )
    with h5py.File(cut / "voltages.h5") as one, h5py.File(run / "voltages.h5") as other:
        name = "tiny-finer/fem/voltages"
        np.testing.assert_array_equal(one[name][:], other[name][:])


@pytest.mark.slow
def test_a_model_that_fails_is_said_and_tried_again(
    suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(suite, scenarios=["tiny-same"], limit=2)
    with monkeypatch.context() as patch:
        patch.setattr(operator_cell, "MODEL_LIMIT_S", 1e-3)
        with pytest.raises(EitbenchError, match=r"'tiny-same' are compared with .*took longer"):
            start_run(plan, tmp_path / "run")
    assert resume_run(tmp_path / "run").path == tmp_path / "run"
    assert (pd.read_parquet(tmp_path / "run" / "samples.parquet")["status"] == "ok").all()


@pytest.mark.parametrize(
    ("choice", "sentence"),
    [
        ({"operators": ["jacobina"]}, "Unknown operator 'jacobina': did you mean 'jacobian'?"),
        ({"methods": ["noser"]}, "'tiny-operators' ranks operators: choose .* with --operators"),
        ({"plugins": [DATA / "broken_contract.py"]}, "registers no operators"),
    ],
)
def test_choices_that_cannot_be_run(choice: dict[str, Any], sentence: str, suite: Suite) -> None:
    with pytest.raises(InputError, match=sentence):
        make_plan(suite, **choice)


def test_methods_and_operators_are_not_mixed(tiny: Suite, suite: Suite) -> None:
    with pytest.raises(InputError, match="'tiny' ranks methods: choose among them with --methods"):
        make_plan(tiny, operators=["fem"])
    assert make_plan(tiny, plugins=[TOYS]).names == ("noser", "toy-method")
    with pytest.raises(InputError, match="'tiny-operators' ranks operators"):
        _ = make_plan(suite).methods  # which are tuned
    recorded = RecordedScenario(name="skin", recording="ohmc16")
    with pytest.raises(InputError, match="'skin' is recorded"):
        OperatorData.load(recorded, suite, None, jobs=1, progress=False)
    uneven = {"imperfections": Imperfections(contact_impedance=0.1)}
    units = scenario(suite, "tiny-finer").model_copy(update=uneven)
    with pytest.raises(InputError, match="sensor of scenario 'tiny-finer' varies"):
        OperatorData.load(units, suite, None, jobs=1, progress=False)
