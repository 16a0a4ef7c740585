"""Figures of real recordings that reports print; they need the recordings."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.support.made_runs import edited_manifest, write_manifest
from tests.support.pressed_skin import SKIN, pressed_skin

from eitbench.benchmark.analysis.recording_notes import notes_of, write_notes
from eitbench.benchmark.analysis.results import NOTES
from eitbench.benchmark.metrics.evaluation import REGISTRATION_FRAMES
from eitbench.benchmark.metrics.load import fit_load
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.hardware.recording.exchange import write_recording
from eitbench.scenarios import load
from eitbench.scenarios.errors import DataUnavailableError
from eitbench.scenarios.recordings.files.pairs import from_pairs
from eitbench.scenarios.suites.scenario import RecordedScenario
from eitbench.scenarios.suites.suite import load_suite

pytestmark = pytest.mark.usefixtures("recorded_data")


def scenario(name: str) -> RecordedScenario:
    return RecordedScenario(name=name, recording=name)


def test_guessing_one_place_is_the_baseline_of_positions() -> None:
    found = notes_of(scenario("hydrogel-rectangle"), 50)
    assert set(found) == set(NOTES)
    places = load(scenario("hydrogel-rectangle"), "validation").samples
    presses = load(scenario("hydrogel-rectangle"), limit=50).samples
    x, y = ((presses[axis] - places[axis].mean()).to_numpy() for axis in ("x_m", "y_m"))
    assert found["guess_mm"] == pytest.approx(1e3 * np.median(np.hypot(x, y)))
    assert found["reciprocity_error"] is None


def test_a_guess_has_the_figures_of_a_method() -> None:
    found = notes_of(scenario("ohmc16"), 200)
    places = load("ohmc16", "validation").samples
    presses = load("ohmc16", limit=200).samples
    away = 1e3 * np.hypot(*((presses[a] - places[a].mean()).to_numpy() for a in ("x_m", "y_m")))
    assert found["guess_within_10_mm"] == pytest.approx(np.mean(away <= 10))
    expected = np.quantile(away, 0.9, method="inverted_cdf")
    assert found["guess_localisation_p90_mm"] == pytest.approx(expected)
    # The error of a guess is the distance from the middle, and neighbours reach further inwards.
    assert found["guess_worst_tenth_mm"] == pytest.approx(expected, rel=0.2)


def test_a_tank_has_reciprocity_and_repeats_but_no_place() -> None:
    found = notes_of(scenario("sciospec-tank"), 50)
    assert found["guess_mm"] is None
    assert found["reciprocity_error"] == pytest.approx(0.026, abs=0.002)
    assert found["repeat_noise"] == pytest.approx(3.2e-4, rel=0.1)


def test_guessing_the_mean_force_is_the_baseline_of_forces(tmp_path: Path) -> None:
    released, pressed, places = pressed_skin(20)
    forces = np.arange(1.0, 21.0)
    content = from_pairs(released, pressed, SKIN, "bench", places.assign(force_N=forces))
    write_recording(content, tmp_path / "forces.h5")
    found = notes_of(RecordedScenario(name="forces", recording=str(tmp_path / "forces.h5")), 16)
    known = forces[::5]  # every fifth touch is for validation
    error = np.median(np.abs(np.delete(forces, np.arange(0, 20, 5)) - known.mean()))
    assert found["guess_force_n"] == pytest.approx(error)
    assert found["guess_load_percent"] == pytest.approx(100 * error / known.max())


def test_the_mean_load_is_guessed_from_the_touches_that_methods_are_fitted_on(
    tmp_path: Path,
) -> None:
    n = 5 * REGISTRATION_FRAMES + 50
    released, pressed, places = (
        np.resize(a, (n, a.shape[1])) for a in map(np.asarray, pressed_skin(20))
    )
    labels = pd.DataFrame(places, columns=["x_m", "y_m"]).assign(force_N=np.arange(1.0, n + 1))
    content = from_pairs(released, pressed, SKIN, "bench", labels)
    write_recording(content, tmp_path / "forces.h5")
    skin = RecordedScenario(name="forces", recording=str(tmp_path / "forces.h5"))
    silent, tested = np.zeros(REGISTRATION_FRAMES), load(skin, "test")
    known = load(skin, "validation", REGISTRATION_FRAMES).samples
    fitted = fit_load(known, silent)
    assert fitted is not None
    error = np.median(fitted.error(np.zeros(len(tested)), tested.samples))
    found = notes_of(skin, n)
    assert found["guess_force_n"] == pytest.approx(error)
    assert found["guess_load_percent"] == pytest.approx(100 * error / fitted.full_scale)
    card = METRICS["measured_force_error_n"].formula
    assert f"on the first {REGISTRATION_FRAMES} validation touches" in card


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run directory of the recorded suite, of which one scenario was run."""
    of_set = scenario("ohmc16").data_hash("test")
    ran = {"hash": of_set, "n": 36, "inverse_crime": None, "sensor": "ohmc16"}
    write_manifest(tmp_path, "recorded", {"ohmc16": ran}, [])
    with edited_manifest(tmp_path) as manifest:
        manifest["plan"]["suite"] = load_suite("recorded").model_dump(mode="json")
    return tmp_path


def test_notes_are_kept_for_the_recorded_scenarios_that_were_run(run: Path) -> None:
    write_notes(run)
    known = {"ohmc16": notes_of(scenario("ohmc16"), 36)}
    assert json.loads((run / "recordings.json").read_text()) == known


def test_notes_stay_those_of_the_data_that_were_run(run: Path) -> None:
    """A recording that was replaced under its name says nothing of the run."""
    write_notes(run)
    before = (run / "recordings.json").read_bytes()
    with edited_manifest(run) as manifest:
        manifest["data"]["ohmc16"] |= {"hash": "c0ffee", "n": 12}
    write_notes(run)
    assert (run / "recordings.json").read_bytes() == before
    with edited_manifest(run) as manifest:
        manifest["data"]["ohmc16"]["hash"] = scenario("ohmc16").data_hash("test")
        manifest["data"]["ohmc16"]["n"] = 36
    for damage in ("[1]", "{"):
        (run / "recordings.json").write_text(damage)
        write_notes(run)
        assert (run / "recordings.json").read_bytes() == before


def test_without_data_there_are_no_notes(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_data(*_: object) -> None:
        raise DataUnavailableError("no network")

    monkeypatch.setattr("eitbench.benchmark.analysis.recording_notes.read_recording", no_data)
    write_notes(run)
    assert not (run / "recordings.json").exists()
