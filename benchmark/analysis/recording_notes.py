"""Quality of the recorded data of a run, stored beside its results."""

import json
from pathlib import Path

import numpy as np

from eitbench.benchmark.analysis.results import NOTES, NOTES_FILE
from eitbench.benchmark.metrics.load import fit_load
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError
from eitbench.scenarios.recordings.descriptors import contact_places
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.quality import quality
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.suites.scenario import RecordedScenario


def write_notes(run: Path) -> None:
    """Write `recordings.json`: the figures of every recorded scenario of the run directory `run`.

    Scenarios whose data are no longer here are left out, and without any there is no file.

    Raises:
        InputError: `run` has no readable manifest.
    """
    manifest = manifests.read(run)
    suite = manifests.suite_of(manifest)
    noted: dict[str, dict[str, float | None]] = {}
    for scenario in suite.scenarios:
        if isinstance(scenario, RecordedScenario) and scenario.name in manifest["data"]:
            try:
                noted[scenario.name] = notes_of(scenario, manifest["data"][scenario.name]["n"])
            except (DataUnavailableError, DataCorruptError):
                continue
    if noted:
        text = json.dumps(noted, indent=2, allow_nan=False) + "\n"
        atomic_write(run / NOTES_FILE, text.encode())


def notes_of(scenario: RecordedScenario, n: int) -> dict[str, float | None]:
    """Quality of a recording, and the error of a blind guess on its first `n` test samples.

    `reciprocity_error` and `repeat_noise` are relative, see `quality`; `guess_mm` is the median
    distance from a contact to the mean contact of the validation split. `guess_force_n` and
    `guess_load_percent` are the errors of always guessing the mean load of the validation split.
    None where not defined.
    """
    guess = _guess_mm(scenario, n) if scenario.recorded_set.truth == "position" else None
    found = quality(read_recording(scenario.recording), scenario.nominal_sensor.pattern)
    values = (*found, guess, *_guessed_loads(scenario, n))
    return {
        name: value if value is not None and np.isfinite(value) else None
        for name, value in zip(NOTES, values, strict=True)
    }


def _guess_mm(scenario: RecordedScenario, n: int) -> float:
    known = contact_places(load(scenario, "validation").samples)
    presses = contact_places(load(scenario, "test", n).samples)
    away = np.linalg.norm(presses - np.nanmean(known, axis=(0, 1)), axis=2)
    return float(1e3 * np.nanmedian(away))


def _guessed_loads(scenario: RecordedScenario, n: int) -> tuple[float | None, float | None]:
    """As the metrics `measured_force_error_n` and `measured_load_error_percent`."""
    known = load(scenario, "validation").samples
    mean = fit_load(known, np.zeros(len(known)))  # images that say nothing
    if mean is None:
        return None, None
    tested = load(scenario, "test", n).samples
    error = float(np.nanmedian(mean.error(np.zeros(len(tested)), tested)))
    return error if mean.quantity == "force_N" else None, 100 * error / mean.full_scale
