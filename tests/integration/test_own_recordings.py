"""Own recordings in suites: ranked like the public ones, by what they hold."""

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.benchmark.analysis.recording_notes import notes_of
from eitbench.benchmark.analysis.rescore import rescore
from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.hardware.board import Frame
from eitbench.hardware.recording.exchange import write_recording
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios import forward_model, load, load_suite, sensor
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError, InputError
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import fetch_recording, read_recording
from eitbench.scenarios.recordings.files.pairs import from_pairs
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import RecordedScenario

SUITE = """
name = "mine"
title = "Own touches"
methods = ["noser", "back-projection"]

[[scenarios]]
kind = "recorded"
name = "touch"
recording = "touch.h5"
"""


def skin() -> Sensor:
    return replace(sensor("foam16"), name="bench", image_shape=(24, 24))


def record(path: Path, n: int = 20, *, places: bool = True, reference: bool = True) -> Path:
    """Three reference frames, then `n` touches of two frames each."""
    bench = skin()
    model, draws = forward_model(bench), np.random.default_rng(4)
    x, y = bench.pixel_centres
    with Recorder(path, bench, "fake") as recorder:

        def measure(image: NDArray[np.float64]) -> int:
            clean = model.voltages(image)
            k = recorder.count
            noise = 1e-3 * np.std(clean) * draws.normal(size=clean.shape)
            recorder.append(Frame(k, k / 10, k / 10, clean + noise))
            return k

        for _ in range(3):
            measure(model.background)
        if reference:
            recorder.mark_reference(0, 2)
        for px, py in draws.uniform(0.02, 0.08, size=(n, 2)):
            away = np.maximum(np.hypot(x - px, y - py) - 0.005, 0)
            image = bench.background * FOAM.pressed(40e3, away)
            first, last = measure(image), measure(image)
            place = {"x_m": px, "y_m": py} if places else {}
            recorder.label(first, last, **place)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("own")
    record(made / "touch.h5")
    (made / "mine.toml").write_text(SUITE)
    return made


def test_a_recording_is_a_recorded_set(folder: Path) -> None:
    path = folder / "touch.h5"
    made = recorded_set(str(path))
    assert (made.name, made.truth, made.sensor()) == ("touch", "position", skin())
    assert made.title == "own recording with the board fake, touches: 20"
    assert sensor(str(path)) == skin()
    assert fetch_recording(made) == path.parent.resolve()
    recording = read_recording(str(path))
    assert recording.voltages.shape == (20, 208)
    assert recording.samples["split"].tolist() == (["validation"] + 4 * ["test"]) * 4
    with h5py.File(path) as file:
        values = file["frames/values"][()]
    assert np.array_equal(recording.reference, values[:3].mean(axis=0))
    assert np.array_equal(recording.voltages[1], values[5:7].mean(axis=0))


@pytest.mark.slow
def test_methods_are_ranked_on_it(folder: Path, tmp_path: Path) -> None:
    suite = load_suite(folder / "mine.toml")
    run = start_run(make_plan(suite), tmp_path / "run").path
    samples = pd.read_parquet(run / "samples.parquet")
    assert len(samples) == 2 * 16
    error = samples.groupby("method")["localisation_mm"].median()
    assert error["noser"] < 5  # it was registered: one place for all would be 20 mm off
    assert set(samples["status"]) == {"ok"}
    assert not samples["phantom"].str.contains("/").any()


def test_its_hash_is_of_what_it_holds(folder: Path, tmp_path: Path) -> None:
    def hashed(path: Path) -> str:
        return RecordedScenario(name="touch", recording=str(path)).data_hash("test")

    elsewhere = tmp_path / "other.h5"
    shutil.copyfile(folder / "touch.h5", elsewhere)
    before = hashed(elsewhere)
    assert before == hashed(folder / "touch.h5")
    with h5py.File(elsewhere, "r+") as file:
        file.attrs["note"] = 1
    assert hashed(elsewhere) != before


@pytest.mark.slow
def test_three_presses_register_and_fewer_are_told(folder: Path, tmp_path: Path) -> None:
    for n in (10, 11):
        (tmp_path / str(n)).mkdir()
        record(tmp_path / str(n) / "touch.h5", n)
        shutil.copyfile(folder / "mine.toml", tmp_path / str(n) / "mine.toml")
    few, enough = (make_plan(load_suite(tmp_path / str(n) / "mine.toml")) for n in (10, 11))
    with pytest.raises(InputError) as caught:
        start_run(few, tmp_path / "few")
    assert str(caught.value) == (
        "Scenario 'touch' has 2 validation presses (every fifth touch), and at least 3 are "
        "needed to find how images map to places: record at least 11 touches."
    )
    run = start_run(enough, tmp_path / "enough").path
    assert len(pd.read_parquet(run / "samples.parquet")) == 2 * 8


def test_touches_without_places_are_ranked_by_nothing(tmp_path: Path) -> None:
    record(tmp_path / "touch.h5", 6, places=False)
    scenario = RecordedScenario(name="touch", recording=str(tmp_path / "touch.h5"))
    assert scenario.recorded_set.truth == "none"
    assert len(load(scenario)) == 4


def test_what_cannot_be_a_set_is_told(folder: Path, tmp_path: Path) -> None:
    record(tmp_path / "empty.h5", 0)
    with pytest.raises(InputError, match="has no labels, so that methods cannot be compared on it"):
        recorded_set(str(tmp_path / "empty.h5"))
    record(tmp_path / "bare.h5", 3, reference=False)
    with pytest.raises(InputError, match="has no reference frames"):
        recorded_set(str(tmp_path / "bare.h5"))
    with pytest.raises(DataUnavailableError, match="Cannot read the recording"):
        recorded_set(str(tmp_path / "none.h5"))
    shutil.copyfile(folder / "touch.h5", tmp_path / "touch.h5")
    with h5py.File(tmp_path / "touch.h5", "r+") as file:
        file["frames/values"][4, 4] += 1
    with pytest.raises(DataCorruptError, match="the checksum of frame 4 is wrong"):
        recorded_set(str(tmp_path / "touch.h5"))
    (tmp_path / "mine.toml").write_text(SUITE)
    with pytest.raises(InputError, match=r"field 'scenarios\[0\].recording' of .*checksum"):
        load_suite(tmp_path / "mine.toml")
    with h5py.File(tmp_path / "bare.h5", "r+") as file:
        file["labels"][0] = (99, 100, 0, 0, 0, 0, 0, b"", -1, -1)
    with pytest.raises(DataCorruptError, match="were changed after it was closed"):
        recorded_set(str(tmp_path / "bare.h5"))


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = record(tmp_path / "touch.h5", 6)
    assert "touches: 6" in recorded_set(str(path)).title
    path.unlink()
    record(path, 7)
    assert "touches: 7" in recorded_set(str(path)).title


@pytest.mark.slow
def test_forces_and_several_contacts_are_judged_in_a_run(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(20)
    # As if each press were half as strong again as the one before, up to 5 N.
    force = np.linspace(1, 5, 20)
    pressed = released + (pressed - released) * force[:, None] / 5
    table = places.assign(force_N=force, touch=range(20))
    table = pd.concat([table, pd.DataFrame([{"touch": 1, "x_m": 0.09, "y_m": 0.07, "force_N": 1}])])
    write_recording(from_pairs(released, pressed, SKIN, "fake", table), tmp_path / "touch.h5")
    (tmp_path / "mine.toml").write_text(SUITE)
    run = start_run(
        make_plan(load_suite(tmp_path / "mine.toml"), methods=["noser"]), tmp_path / "r"
    )
    samples = pd.read_parquet(run.path / "samples.parquet")
    assert set(samples["contact_count_error"]) == {0, 1}
    assert samples["localisation_mm"].median() < 5
    assert samples["measured_force_error_n"].median() < 0.3  # a guess: 1.2
    percent = samples["measured_load_error_percent"] / samples["measured_force_error_n"]
    np.testing.assert_allclose(percent, 100 / force[15])  # of the largest of the validation split
    assert {again.changed for again in rescore(run.path)} == {0}
    (touch,) = load_suite(tmp_path / "mine.toml").scenarios
    assert isinstance(touch, RecordedScenario)
    assert notes_of(touch, 16)["guess_mm"] == pytest.approx(20, abs=10)
