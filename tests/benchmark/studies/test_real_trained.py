"""The track that learns from real presses: every press is scored once, without learning from it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.benchmark import InputError
from eitbench.benchmark.studies import real_trained as track
from eitbench.benchmark.studies.real_trained import Presses, real_trained
from eitbench.hardware.recording.exchange import write_recording
from eitbench.methods.places.place_network import REAL, SIMULATED
from eitbench.reports.studies.real_trained import summary, to_markdown, write_real_trained
from eitbench.scenarios import RecordedScenario
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.recordings.files.pairs import from_pairs


def presses(n: int, seed: int, gain: float) -> Presses:
    """Frames of 40 values that fall off with the distance from 40 points, on one board."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-0.06, 0.06, (n, 2))
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (40, 2))
    channels = np.exp(gain * np.random.default_rng(1).standard_normal(40))
    distance = np.linalg.norm(places[:, None] - points, axis=2)
    return Presses(channels * np.exp(-((distance / 0.04) ** 2)), places)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One network, few steps, and a board of uneven channels that the simulation knows not of."""
    monkeypatch.setattr(track, "SEEDS", (0,))
    monkeypatch.setattr(track, "COUNTS", (0, 25, 100))
    phase = replace(SIMULATED, steps=300, gain=0.3, noise=0.1)
    monkeypatch.setattr(track, "SIMULATED", phase)
    monkeypatch.setattr(track, "REAL", replace(REAL, steps=150, noise=0.05))
    monkeypatch.setattr(track, "_real", lambda scenario: presses(150, 2, 0.5))
    monkeypatch.setattr(track, "_simulated", lambda scenario: presses(600, 3, 0.0))


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_errors_fall_with_the_presses_that_are_learned_from(tmp_path: Path) -> None:
    errors = real_trained("ohmc16")
    for _, group in errors.groupby(["estimator", "presses"]):
        assert sorted(group["press"]) == list(range(150))
    rows = {(row["estimator"], row["presses"]): row["median_mm"] for row in summary(errors)}
    for name in ("ridge", "kernel ridge", "network", "fine-tuned network"):
        assert rows[name, 100] < rows[name, 25] < rows["one place", 25]
        assert (name, 0) not in rows
    assert rows["fine-tuned network", 25] < rows["network", 25]
    assert rows["fine-tuned network", 25] < rows["simulated network", 0]
    written = write_real_trained(errors, "ohmc16", tmp_path / "new")
    assert all(path.stat().st_size > 0 for path in written)
    assert "| ridge | – |" in to_markdown(summary(errors))


def test_no_press_is_learned_from_and_scored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames without information: only a press that was seen could be placed right."""
    rng = np.random.default_rng(0)
    blind = Presses(rng.standard_normal((150, 40)), rng.uniform(-0.06, 0.06, (150, 2)))
    monkeypatch.setattr(track, "COUNTS", (100,))
    monkeypatch.setattr(track, "SEEDS", ())
    monkeypatch.setattr(track, "_real", lambda scenario: blind)
    monkeypatch.setattr(track, "_simulated", lambda scenario: blind)
    monkeypatch.setattr(
        track.Estimators,
        "known",
        lambda self, count: {"memory": lambda seen: lambda frames: _nearest(seen, frames)},
    )
    assert real_trained("ohmc16")["error_mm"].min() > 0


def _nearest(seen: Presses, frames: Array) -> Array:
    distance = np.linalg.norm(frames[:, None] - seen.frames, axis=2)
    return np.asarray(seen.places[distance.argmin(axis=1)])


def test_sets_without_places_or_with_few_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="does not know where it was pressed"):
        real_trained("ktc2023")
    monkeypatch.setattr(track, "_real", lambda scenario: presses(31, 0, 0.0))
    with pytest.raises(InputError, match="has 31 presses, and at least 32 are needed to learn"):
        real_trained("ohmc16")


def own(folder: Path, n: int, *contacts: dict[str, float]) -> Path:
    """A recording of one's own, of `n` touches on a small sensor."""
    released, pressed, places = pressed_skin(n)
    more = places.assign(touch=range(n))
    more = pd.concat([more, pd.DataFrame(contacts)]) if contacts else more
    path = folder / "my own.h5"
    write_recording(from_pairs(released, pressed, SKIN, "fake", more), path)
    return path


def test_a_recording_of_one_s_own_is_learned_from_as_far_as_it_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blind = presses(20, 0, 0.0)
    monkeypatch.setattr(track, "SEEDS", ())
    monkeypatch.setattr(track, "_simulated", lambda scenario: blind)
    learn = {"one place": lambda seen: lambda frames: np.zeros((len(frames), 2))}
    monkeypatch.setattr(track.Estimators, "known", lambda self, count: learn)
    errors = real_trained(str(own(tmp_path, 40)))
    assert set(errors["presses"]) == {0, 25}
    (tmp_path / "moved").mkdir()
    moved = (tmp_path / "my own.h5").rename(tmp_path / "moved" / "b.h5")
    pd.testing.assert_frame_equal(errors, real_trained(str(moved)))


def test_touches_of_several_contacts_are_no_single_presses(tmp_path: Path) -> None:
    path = own(tmp_path, 40, {"touch": 3, "x_m": 0.05, "y_m": 0.05})
    with pytest.raises(InputError, match="has touches of several contacts"):
        real_trained(str(path))


@pytest.mark.usefixtures("recorded_data")
def test_the_real_presses_are_all_there() -> None:
    real = track._real(RecordedScenario(name="ohmc16", recording="ohmc16"))
    assert real.frames.shape == (500, 192)
    assert np.ptp(real.places, axis=0).min() > 0.1
