"""Data sets: what `load` gives, its hashes, its flags and its errors."""

import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.support.families import PUBLISHED_FAMILIES

from eitbench.scenarios import catalogue, load
from eitbench.scenarios.data.datasets import same_reference
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings import RECORDED_SETS, RecordedFrames, RecordedSet, fetch
from eitbench.scenarios.recordings.descriptors import RecordedFile, Source
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import foam16
from eitbench.scenarios.suites.scenario import (
    TOUCHES,
    RecordedScenario,
    SimulatedScenario,
    Split,
    SplitNoise,
)

SMALL: dict[str, Any] = {
    "name": "small",
    "image_shape": (12, 12),
    "families": PUBLISHED_FAMILIES,
    "noise": SplitNoise(train="mixture", validation=30, test=40),
    "imperfections": Imperfections(mesh="fine"),
    "train": 30,
    "validation": 10,
    "test": 20,
}
SCENARIO = SimulatedScenario(**SMALL)


def test_dataset_holds_what_the_contract_says() -> None:
    data = load(SCENARIO, "test")
    assert len(data) == 20
    assert data.voltages.shape == (20, 208)
    assert data.references.shape == (20, 208)
    assert data.conductivity is not None
    assert data.conductivity.shape == (20, 12, 12)
    assert {data.voltages.dtype, data.references.dtype, data.conductivity.dtype} == {np.dtype("f8")}
    assert data.truth == "conductivity"
    assert data.sensor.image_shape == (12, 12)
    assert list(data.samples["sample"]) == list(range(20))
    assert list(data.samples["family"][:6]) == list(PUBLISHED_FAMILIES)
    assert (data.samples["snr_db"] == 40).all()
    assert data.samples["radius_m"].notna().sum() == 4
    assert data.samples.index.equals(pd.RangeIndex(20))


def test_default_split_is_test_and_a_limit_gives_the_first() -> None:
    every, few = load(SCENARIO), load(SCENARIO, limit=np.int64(7))  # type: ignore[arg-type]
    assert every.split == few.split == "test"
    assert np.array_equal(few.voltages, every.voltages[:7])
    assert np.array_equal(few.references, every.references[:7])
    assert few.frame_hashes == every.frame_hashes[:7]
    assert len(load(SCENARIO, limit=1000)) == 20


def test_packaged_scenario_by_name() -> None:
    data = load("paper", split="test", limit=2)
    assert data.voltages.shape == (2, 208)
    assert data.conductivity is not None
    assert data.conductivity.shape == (2, 80, 80)
    assert data.samples["snr_db"].isna().all()
    assert data.inverse_crime is True
    nominal = forward_model(data.sensor)
    assert np.allclose(data.voltages, nominal.voltages(data.conductivity), rtol=1e-12)
    assert np.allclose(data.references, nominal.voltages(nominal.background), rtol=1e-12)


def test_conductivity_is_the_truth_on_the_nominal_grid_not_the_finer_one() -> None:
    data = load(SCENARIO, limit=6)
    nominal = forward_model(data.sensor)
    assert data.conductivity is not None
    modelled = nominal.voltages(data.conductivity) - nominal.voltages(nominal.background)
    clean = load(SCENARIO.model_copy(update={"noise": SplitNoise()}), limit=6)
    measured = clean.voltages - clean.references
    # The same contacts on another mesh: alike, not equal.
    for one, other in zip(modelled, measured, strict=True):
        assert np.corrcoef(one, other)[0, 1] > 0.98
    assert not np.allclose(modelled, measured, rtol=1e-3)


def test_every_session_measures_its_own_reference_with_the_noise_of_its_split() -> None:
    clean = load(SCENARIO.model_copy(update={"noise": SplitNoise()})).references
    assert (clean == clean[0]).all()  # one sensor, without noise
    for split, snr_db in (("validation", 30), ("test", 40)):
        data = load(SCENARIO, split)
        rows = [slice(k, k + TOUCHES) for k in range(0, len(data), TOUCHES)]
        assert same_reference(data.references) == [
            slice(r.start, min(r.stop, len(data))) for r in rows
        ]
        noise = (data.references - clean[: len(data)])[::TOUCHES]
        scale = np.sqrt(np.mean(clean[0] ** 2)) * 10 ** (-snr_db / 20)
        # At least 4 x 208 values tell a deviation to 2.5 %; sessions share none of it.
        assert noise.std() == pytest.approx(scale, rel=0.1)
        assert np.abs(np.corrcoef(noise) - np.eye(len(noise))).max() < 0.3
        assert list(data.samples["session"]) == [k // TOUCHES for k in range(len(data))]


def test_a_mixture_has_one_level_in_a_session() -> None:
    data = load(SCENARIO.model_copy(update={"train": 60}), "train")
    levels = data.samples.groupby("session")["snr_db"]
    assert (levels.nunique(dropna=False) == 1).all()
    clean = forward_model(data.sensor)
    reference = clean.voltages(clean.background)
    quiet = data.samples["snr_db"].isna().to_numpy()
    assert np.allclose(data.references[quiet], reference, rtol=1e-12)
    noise = (data.references - reference)[~quiet][::TOUCHES]
    level = data.samples["snr_db"][~quiet].to_numpy()[::TOUCHES]
    scale = np.sqrt(np.mean(reference**2)) * 10 ** (-level / 20)
    assert (noise.std(axis=1) / scale) == pytest.approx(np.ones(len(level)), abs=0.25)


def test_samples_of_one_session_are_one_cluster_where_they_share_something() -> None:
    noisy = load(SCENARIO, limit=7).samples
    assert noisy["cluster"].nunique() == 3
    assert noisy.groupby("session")["cluster"].nunique().tolist() == [1, 1, 1]
    clean = load(SCENARIO.model_copy(update={"noise": SplitNoise()}), limit=7).samples
    assert clean["cluster"].tolist() == clean["phantom"].tolist()
    board = Imperfections(gain=0.01)
    drawn = SCENARIO.model_copy(update={"noise": SplitNoise(), "imperfections": board})
    assert load(drawn, limit=7).samples["cluster"].nunique() == 3
    # A frame that is seen again is that of the touch before.
    losing = drawn.model_copy(update={"imperfections": Imperfections(lost_every=3)})
    assert load(losing, limit=7).samples["cluster"].nunique() == 3


def test_every_session_is_on_a_unit_of_its_own_and_none_is_in_two_splits() -> None:
    """A touch of one pixel's conductivity would not tell: the electrodes and gains do."""
    board = Imperfections(electrode_shift_m=1e-3, gain=0.02)
    made = SCENARIO.model_copy(update={"noise": SplitNoise(), "imperfections": board})
    frames = {split: load(made, split, 9).references for split in ("validation", "test")}
    every = np.concatenate([rows[::TOUCHES] for rows in frames.values()])
    assert len(np.unique(every, axis=0)) == 6
    # The spread of units is that of the declared gain, and more.
    assert 0.01 < (every.std(axis=0) / np.abs(every).mean(axis=0)).mean() < 0.2
    nominal = load(made, "train", 9).references
    model = forward_model(SCENARIO.nominal_sensor)
    assert np.allclose(nominal, model.voltages(model.background), rtol=1e-12)
    rung = made.model_copy(update={"ladder": True})
    assert np.array_equal(load(rung, "validation", 9).references, nominal)
    assert np.array_equal(load(rung, "test", 9).references, frames["test"])


def test_the_snr_of_the_touch_is_measured_against_the_untouched_sensor() -> None:
    noisy, clean = load(SCENARIO), load(SCENARIO.model_copy(update={"noise": SplitNoise()}))
    noise = np.sqrt(np.mean((noisy.voltages - clean.voltages) ** 2, axis=1))
    touch = np.sqrt(np.mean((clean.voltages - clean.references) ** 2, axis=1))
    # 208 values tell the size of the noise to 5 %, 0.4 dB.
    expected = 20 * np.log10(touch / noise)
    np.testing.assert_allclose(noisy.samples["touch_snr_db"], expected, atol=2)
    assert clean.samples["touch_snr_db"].isna().all()


def test_what_a_dead_electrode_would_have_measured_is_no_signal() -> None:
    board = Imperfections(dead=(5, 12))
    faulty = SCENARIO.model_copy(update={"imperfections": board})
    noisy, clean = load(faulty), load(faulty.model_copy(update={"noise": SplitNoise()}))
    rms = np.sqrt(np.mean(clean.voltages**2, axis=1))
    touch = np.sqrt(np.mean((clean.voltages - clean.references) ** 2, axis=1))
    expected = noisy.samples["snr_db"] + 20 * np.log10(touch / rms)
    np.testing.assert_allclose(noisy.samples["touch_snr_db"], expected, atol=1e-6)


def test_splits_have_their_own_noise_and_samples() -> None:
    train, validation = load(SCENARIO, "train"), load(SCENARIO, "validation")
    assert 0 < train.samples["snr_db"].isna().sum() < 30
    assert (validation.samples["snr_db"] == 30).all()
    assert not set(train.frame_hashes) & set(validation.frame_hashes)


def test_frame_hashes_tell_frames_and_references_apart() -> None:
    data = load(SCENARIO)
    assert len(set(data.frame_hashes)) == 20
    other = replace(data, references=np.nextafter(data.references, np.inf))
    assert not set(data.frame_hashes) & set(other.frame_hashes)


def test_arrays_cannot_be_changed_by_a_method() -> None:
    data = load(SCENARIO)
    for array in (data.voltages, data.references, data.conductivity):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


OTHER: dict[str, Any] = {
    "acuity": {},
    "name": "other",
    "sensor": "foam16-adjacent",
    "image_shape": (14, 12),
    "conductivity_range": (0.05, 3.0),
    "families": ("circle", "star"),
    "training_families": ("circle",),
    "noise": SplitNoise(train="mixture", validation=30, test=41),
    "train": 31,
    "validation": 11,
    "test": 21,
    "phantoms": "others",
    "imperfections": Imperfections(gain=0.01),
    "ladder": True,
    "calibrated": True,
    "training_imperfections": {"drift": 0.01},
}


@pytest.mark.parametrize(
    "field", sorted(set(SimulatedScenario.model_fields) - {"kind", "familiar"})
)
def test_changing_any_declared_parameter_changes_the_data_hash(
    field: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    adjacent = replace(foam16(), pattern=offset_pattern(16, 1))
    builders = {**catalogue.sensors(), "foam16-adjacent": lambda: adjacent}
    monkeypatch.setattr(catalogue, "sensors", lambda: builders)
    changed = SimulatedScenario(**{**SMALL, field: OTHER[field]})
    splits: tuple[Split, ...] = ("train", "validation", "test")
    # Imperfections of training units have no part in the others.
    for split in splits[:1] if field == "training_imperfections" else splits:
        assert changed.data_hash(split) != SCENARIO.data_hash(split)


def test_what_a_scenario_is_told_from_has_no_part_in_its_data() -> None:
    told = SCENARIO.model_copy(update={"familiar": "another"})
    assert told.data_hash("test") == SCENARIO.data_hash("test")


@pytest.mark.parametrize("split", SplitNoise.model_fields)
def test_changing_the_noise_of_any_split_changes_the_data_hash(split: str) -> None:
    noise = SCENARIO.noise.model_copy(update={split: 33.0})
    other = SCENARIO.model_copy(update={"noise": noise})
    assert other.data_hash("test") != SCENARIO.data_hash("test")


def test_changing_the_ranges_of_a_family_changes_the_data_hash(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = SCENARIO.data_hash("test")
    monkeypatch.setitem(FAMILIES, "ring", replace(FAMILIES["ring"], conductivity=(0.2, 0.9)))
    assert SCENARIO.data_hash("test") != before


def test_data_hash_is_the_same_in_another_process_and_differs_between_splits() -> None:
    code = (
        "import sys; from eitbench.scenarios import SimulatedScenario as S;"
        "print(S.model_validate_json(sys.argv[1]).data_hash('test'))"
    )
    command = [sys.executable, "-c", code, SCENARIO.model_dump_json()]
    there = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    assert there == SCENARIO.data_hash("test") == load(SCENARIO, limit=1).data_hash
    assert len({SCENARIO.data_hash(s) for s in ("train", "validation", "test")}) == 3


def test_inverse_crime_is_that_of_the_mesh_of_the_data() -> None:
    for mesh, crime in (("image", True), ("fine", False), ("unstructured", False)):
        board = Imperfections.model_validate({"mesh": mesh})
        assert SCENARIO.model_copy(update={"imperfections": board}).inverse_crime is crime
    assert "inverse_crime" not in SimulatedScenario.model_fields


EMPTY = SCENARIO.model_copy(update={"train": 0})
NO_COUNTS = (0, -2, 2.5, "3", True, float("nan"))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        ({"scenario": "papper"}, "did you mean 'paper'"),
        ({"split": "tset"}, "did you mean 'test'"),
        ({"scenario": EMPTY, "split": "train"}, "declares no train samples"),
        *(
            ({name: bad}, f"{name} is|of {name} is")
            for name in ("limit", "jobs")
            for bad in NO_COUNTS
        ),
    ],
)
def test_bad_calls_are_one_sentence(call: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        load(**({"scenario": SCENARIO} | call))


SOURCE = Source("a/b", "0" * 40, "MIT", (RecordedFile("f", 1, "0" * 64),))


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> RecordedScenario:
    """A recorded set of five frames, the third and the fifth for test."""
    frames = np.arange(5 * 208, dtype=float).reshape(5, 208)
    samples = pd.DataFrame(
        {
            "split": ["validation", "validation", "test", "validation", "test"],
            "x_m": [0.1, 0.2, 0.3, 0.4, 0.5],
        }
    )
    classes = np.arange(5, dtype=np.int8)[:, None, None] * np.ones((80, 80), dtype=np.int8)
    recording = RecordedFrames(frames, np.ones(208), samples, classes)
    descriptor = RecordedSet(
        name="bench", title="", sensor_name="foam16", sensor=foam16, truth="classes",
        source=SOURCE, citation="", reader=lambda folder, sensor: recording,
    )  # fmt: skip
    monkeypatch.setitem(RECORDED_SETS, "bench", descriptor)
    monkeypatch.setattr(fetch, "read_recording", lambda name, **options: recording)
    return RecordedScenario(name="bench", recording="bench")


def test_recorded_scenario_gives_its_split(recorded: RecordedScenario) -> None:
    data = load(recorded, "test")
    assert np.array_equal(data.voltages[:, 0], [2 * 208, 4 * 208])
    assert list(data.samples["sample"]) == [0, 1]
    assert list(data.samples["x_m"]) == [0.3, 0.5]
    assert "split" not in data.samples
    assert data.classes is not None
    assert list(data.classes[:, 0, 0]) == [2, 4]
    assert (data.truth, data.inverse_crime, data.conductivity) == ("classes", None, None)
    assert len(load(recorded, "validation", limit=2)) == 2


def test_recorded_scenario_has_no_training_split(recorded: RecordedScenario) -> None:
    with pytest.raises(InputError, match="'bench' has no training split"):
        load(recorded, "train")


def test_recorded_data_hash_follows_the_files(
    recorded: RecordedScenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = recorded.data_hash("test")
    assert recorded.data_hash("validation") != before
    altered = replace(SOURCE, files=(RecordedFile("f", 1, "1" * 64),))
    other = replace(RECORDED_SETS["bench"], source=altered)
    monkeypatch.setitem(RECORDED_SETS, "bench", other)
    assert recorded.data_hash("test") != before
