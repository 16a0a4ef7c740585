"""Simulated voltages: the same bits however they are made, and a cache that cannot go wrong."""

import errno
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
import pytest
from safetensors.numpy import load as load_bytes
from safetensors.numpy import save
from tests.support.families import PUBLISHED_FAMILIES

from eitbench.scenarios.data import simulation
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import CHUNK, clean_frames, phantom
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays
from eitbench.scenarios.suites.scenario import TOUCHES, SimulatedScenario, Split, SplitNoise

BENCH = """
name = "bench"
[outline]
rectangle_mm = [100, 80]
[electrodes]
count = 16
width_mm = 8
[pattern]
offset = 3
"""
SCENARIO = SimulatedScenario(
    name="small",
    image_shape=(12, 12),
    families=PUBLISHED_FAMILIES,
    noise=SplitNoise(train="mixture", test=40),
    imperfections=Imperfections(mesh="fine"),
    train=70,
    validation=10,
    test=70,
)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def files(cache: Path) -> list[Path]:
    return sorted(path for path in cache.rglob("*") if path.is_file())


@pytest.fixture
def solves(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts the images solved in this process."""
    counted: list[int] = []
    solve = ForwardModel.voltages

    def counting(self: ForwardModel, sigma: np.ndarray) -> np.ndarray:
        counted.append(1)
        return solve(self, sigma)

    monkeypatch.setattr(ForwardModel, "voltages", counting)
    return counted


def test_voltages_are_those_of_the_phantoms_on_the_finer_mesh() -> None:
    made = clean_frames(SCENARIO, "test", 3).voltages
    model = SCENARIO.data_model("test")
    assert model.sensor.image_shape == (24, 24)
    for k in range(3):
        sigma = rasterise(phantom(SCENARIO, "test", k), model.sensor)
        assert np.array_equal(made[k], model.voltages(sigma))


def test_frames_and_references_are_of_their_times_and_of_the_touch_before() -> None:
    """Drift and what is left of the last touch, put together here from the models themselves."""
    board = Imperfections(drift=0.05, relaxation=0.3, mains=0.01, reference_age_s=600.0)
    aged = SCENARIO.model_copy(
        update={"imperfections": board, "noise": SplitNoise(test="clean"), "test": 6}
    )
    data = load(aged, "test", 6)
    for k in range(6):
        unit = aged.split_imperfections("test", k // 3)
        model = aged.data_model("test", k // 3)
        assert isinstance(model, ForwardModel)
        touch = rasterise(phantom(aged, "test", k), model.sensor)
        before = rasterise(phantom(aged, "test", k - 1), model.sensor) if k else model.background
        left = (before / model.sensor.background) ** 0.3
        clean = model.voltages(unit.drifted(model.sensor, 10.0 * k) * touch * left)
        untouched = model.voltages(unit.drifted(model.sensor, -600.0) * model.background)
        times = np.array([10.0 * k, -600.0])
        expected = unit.analogue(
            np.stack([clean, untouched]), untouched, model.sensor.pattern, times
        )
        np.testing.assert_allclose(data.voltages[k], expected[0], rtol=1e-9)
        np.testing.assert_allclose(data.references[k], expected[1], rtol=1e-9)


@pytest.mark.slow
def test_sample_is_the_same_whatever_the_count_the_order_and_the_number_of_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(folder: str, *limits: int, jobs: int = 1) -> np.ndarray:
        monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / folder))
        return [load(SCENARIO, "test", limit, jobs=jobs) for limit in limits][-1].voltages

    at_once = made("at-once", 70)
    assert np.array_equal(made("parallel", 70, jobs=2), at_once)
    assert np.array_equal(made("grown", 1, 5, 33, 40, 70), at_once)
    assert np.array_equal(made("shrunk", 70, 7), at_once[:7])
    assert np.array_equal(made("few", 41), at_once[:41])


def test_second_time_nothing_is_solved(cache: Path, solves: list[int]) -> None:
    first = clean_frames(SCENARIO, "test", 40).voltages
    assert len(solves) == 40 + 2  # each of two files begins with the untouched sensor
    before = {path: path.stat().st_mtime_ns for path in files(cache)}
    again = clean_frames(SCENARIO, "test", 40).voltages
    assert len(solves) == 42
    assert np.array_equal(first, again)
    assert {path: path.stat().st_mtime_ns for path in files(cache)} == before


def test_a_test_split_that_is_loaded_again_solves_nothing(solves: list[int]) -> None:
    first = load(SCENARIO, "test", 6)
    # By the model of the data and by that of methods, each with the untouched sensor.
    assert len(solves) == 2 * (6 + 1)
    again = load(SCENARIO, "test", 6)
    assert len(solves) == 14
    pd.testing.assert_frame_equal(first.samples, again.samples)


def test_data_of_the_model_of_methods_are_solved_once(solves: list[int]) -> None:
    same = SCENARIO.without_imperfections
    assert (load(same, "test", 6).samples["model_distance_db"] == np.inf).all()
    assert len(solves) == 6 + 1


def test_a_file_with_fewer_samples_is_completed_and_one_with_more_is_kept(
    cache: Path, solves: list[int]
) -> None:
    clean_frames(SCENARIO, "test", 5)
    clean_frames(SCENARIO, "test", 8)
    assert len(solves) == 8 + 1
    clean_frames(SCENARIO, "test", 3)
    clean_frames(SCENARIO, "test", 8)
    assert len(solves) == 8 + 1
    clean_frames(SCENARIO, "test", CHUNK + 1)
    clean_frames(SCENARIO, "train", 2)
    assert [path.stem for path in files(cache)] == ["test-000000", "test-000030", "train-000000"]


def test_frames_of_a_sensor_file_that_changed_meanwhile_are_not_stored(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their names would be those of the sensor as it was."""
    path = tmp_path / "bench.toml"
    path.write_text(BENCH)
    scenario = SimulatedScenario.model_validate(SCENARIO.model_dump() | {"sensor": str(path)})
    conductivity = simulation.conductivity

    def edited(scenario: SimulatedScenario, split: Split, sample: int) -> np.ndarray:
        path.write_text(BENCH.replace("width_mm = 8", "width_mm = 8.5"))
        return conductivity(scenario, split, sample)

    with monkeypatch.context() as patch:
        patch.setattr(simulation, "conductivity", edited)
        with pytest.raises(InputError, match="was changed while its frames were simulated"):
            clean_frames(scenario, "test", 2)
    assert files(cache) == []
    assert len(clean_frames(scenario, "test", 2).voltages) == 2


def test_the_distance_of_the_model_is_that_of_what_a_touch_changes() -> None:
    """Of a board without noise, from the two models: how much of a change methods cannot explain.

    Its gains and its drift of the reference are in what is sent; methods fit one factor.
    """
    board = Imperfections(mesh="fine", electrode_shift_m=5e-4, gain=0.02, drift=0.01,
                          reference_age_s=3600)  # fmt: skip
    scenario = SCENARIO.model_copy(update={"imperfections": board, "noise": SplitNoise()})
    found = load(scenario, "test", TOUCHES)
    ideal = load(scenario.without_imperfections, "test", TOUCHES)
    model = forward_model(scenario.nominal_sensor)
    nominal = model.voltages(model.background)
    seen = found.voltages - found.references
    expected = ideal.voltages - nominal
    for k in range(TOUCHES):
        gain = nominal @ found.references[k] / (nominal @ nominal)
        apart = np.linalg.norm(seen[k] - gain * expected[k]) / np.linalg.norm(seen[k])
        assert found.samples["model_distance_db"][k] == pytest.approx(-20 * np.log10(apart))


def test_scenarios_that_differ_in_noise_only_share_the_cache(solves: list[int]) -> None:
    shared = {"phantoms": "common"}
    first = SCENARIO.model_copy(update=shared)
    second = SCENARIO.model_copy(update={**shared, "name": "other", "noise": SplitNoise(test=30)})
    clean = clean_frames(first, "test", 4).voltages
    assert np.array_equal(clean_frames(second, "test", 4).voltages, clean)
    assert len(solves) == 4 + 1
    assert not np.array_equal(load(first, "test", 4).voltages, load(second, "test", 4).voltages)


def other_parameters(path: Path) -> None:
    found = read_arrays(path)
    assert found is not None
    write_arrays(path, found[0], {"parameters": "{}"})


DAMAGE: dict[str, Callable[[Path], object]] = {
    "a bit": lambda p: p.write_bytes(p.read_bytes()[:-1] + bytes([p.read_bytes()[-1] ^ 1])),
    "cut": lambda p: p.write_bytes(p.read_bytes()[:-200]),
    "empty": lambda p: p.write_bytes(b""),
    "another format": lambda p: p.write_bytes(b"\0" * 4000),
    "no checksum": lambda p: p.write_bytes(save(load_bytes(p.read_bytes()))),
    "other parameters": other_parameters,
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_corrupt_cache_file_is_noticed_named_and_made_again(
    damage: str, cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    good = clean_frames(SCENARIO, "test", 2).voltages
    (path,) = files(cache)
    DAMAGE[damage](path)
    with caplog.at_level(logging.WARNING):
        assert np.array_equal(clean_frames(SCENARIO, "test", 2).voltages, good)
    assert len(caplog.records) == 1
    assert str(path) in caplog.text
    assert "made again" in caplog.text
    caplog.clear()
    assert np.array_equal(clean_frames(SCENARIO, "test", 2).voltages, good)
    assert not caplog.records


GENERATE = """
import sys
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.data.simulation import clean_frames
scenario = SimulatedScenario.model_validate_json(sys.argv[1])
print("started", flush=True)
clean_frames(scenario, "test", int(sys.argv[2]))
"""


def generating(scenario: SimulatedScenario, count: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", GENERATE, scenario.model_dump_json(), str(count)]
    return subprocess.Popen(command, stdout=subprocess.PIPE)


@pytest.mark.slow
def test_killed_generation_leaves_whole_files_that_are_used(
    cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    slow = SCENARIO.model_copy(update={"test": 100_000})
    process = generating(slow, 100_000)
    deadline = time.monotonic() + 60
    while len(list(cache.rglob("*.safetensors"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    whole = [path for path in files(cache) if path.suffix == ".safetensors"]
    assert len(whole) >= 3
    made = clean_frames(slow, "test", 3 * CHUNK).voltages
    assert not caplog.records
    assert made.shape == (3 * CHUNK, 208)
    assert np.array_equal(made[:2], clean_frames(slow, "test", 2).voltages)


@pytest.mark.slow
def test_processes_that_generate_the_same_at_once_leave_one_good_copy(cache: Path) -> None:
    processes = [generating(SCENARIO, 70) for _ in range(2)]
    assert [process.wait(timeout=120) for process in processes] == [0, 0]
    for process in processes:
        process.communicate()
    assert [path.stem for path in files(cache)] == [f"test-{k:06d}" for k in (0, 30, 60)]
    shared = clean_frames(SCENARIO, "test", 70).voltages
    for path in files(cache):
        path.unlink()
    assert np.array_equal(clean_frames(SCENARIO, "test", 70).voltages, shared)


def test_threads_that_generate_the_same_at_once_agree(cache: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(lambda n: clean_frames(SCENARIO, "test", n).voltages, (3, 20, 7, 20)))
    for frames in made:
        assert np.array_equal(frames, made[1][: len(frames)])
    assert [path.stem for path in files(cache)] == ["test-000000"]


def test_unwritable_cache_folder_is_one_clear_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A file where the folder should be stops root too, whom permissions do not.
    (tmp_path / "taken").write_text("")
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "taken"))
    with pytest.raises(EitbenchError, match=r"cache.*set EITBENCH_CACHE to another folder\.$"):
        clean_frames(SCENARIO, "test", 1)


class ThreadedParallel(joblib.Parallel):  # type: ignore[misc]
    def __init__(self, **options: object) -> None:
        super().__init__(**{**options, "backend": "threading"})


def test_progress_is_shown_on_stderr_and_only_when_there_is_something_to_do(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    load(SCENARIO, "test", 2, progress=True)
    assert capsys.readouterr().err == ""
    # Rich takes this as a terminal.
    monkeypatch.setenv("FORCE_COLOR", "1")
    load(SCENARIO, "test", 3, progress=True)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "Simulating small" in shown.err
    load(SCENARIO, "test", 3, progress=True)
    assert capsys.readouterr().err == ""


def test_any_first_samples_are_balanced_and_resemble_no_other_split() -> None:
    families = [phantom(SCENARIO, "test", k).family for k in range(60)]
    assert {families.count(name) for name in PUBLISHED_FAMILIES} == {10}
    assert families[:6] == list(PUBLISHED_FAMILIES)
    drawn = {
        tuple(phantom(SCENARIO, split, k).parameters.values())
        for split in ("train", "validation", "test")
        for k in range(20)
    }
    assert len(drawn) == 60


@pytest.mark.parametrize("jobs", [1, 2])
def test_full_disk_is_one_clear_sentence_and_leaves_nothing(
    jobs: int, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Path, target: Path) -> Path:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "replace", full)
    if jobs == 2:
        # Worker processes do not share the patch, so it is run on threads.
        monkeypatch.setattr(joblib, "Parallel", ThreadedParallel)
    with pytest.raises(EitbenchError, match="No space left on device"):
        clean_frames(SCENARIO, "test", 40, jobs=jobs)
    # The other job may have been about to clean up, too.
    deadline = time.monotonic() + 120
    while files(cache) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert files(cache) == []
