"""Quality of the recorded data of a run, stored beside its results."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import GUESS, NOTES, NOTES_FILE, STORED_NOTES
from eitbench.benchmark.metrics.aggregation import figure_of
from eitbench.benchmark.metrics.evaluation import REGISTRATION_FRAMES
from eitbench.benchmark.metrics.load import fit_load
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError
from eitbench.scenarios.recordings.descriptors import contact_places
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.quality import quality
from eitbench.scenarios.storage.atomic_write import atomic_write_json
from eitbench.scenarios.suites.scenario import RecordedScenario


def write_notes(run: Path) -> None:
    """Write `recordings.json`: the notes of `noted` on the run directory `run`, if there are any.

    Notes that it has already stay where the data are no longer here.

    Raises:
        InputError: `run` has no readable manifest.
    """
    path = run / NOTES_FILE
    found: dict[str, dict[str, float | None]] = {}
    with suppress(OSError, ValueError):  # none, or damaged: they are made again
        found |= STORED_NOTES.validate_json(path.read_bytes())
    if found := found | noted(manifests.read(run)):
        atomic_write_json(path, found)


def noted(manifest: manifests.Manifest) -> dict[str, dict[str, float | None]]:
    """Return the figures of every recorded scenario of a run, by its name, see `notes_of`.

    Scenarios whose data are no longer here, or are others than those of the run, are left out.
    """
    found: dict[str, dict[str, float | None]] = {}
    for scenario in manifests.suite_of(manifest).scenarios:
        data = manifest["data"].get(scenario.name)
        if not isinstance(scenario, RecordedScenario) or data is None:
            continue
        with suppress(DataUnavailableError, DataCorruptError):
            if scenario.data_hash("test") == data["hash"]:
                found[scenario.name] = notes_of(scenario, data["n"])
    return found


def notes_of(scenario: RecordedScenario, n: int) -> dict[str, float | None]:
    """Quality of a recording, and the error of a blind guess on its first `n` test samples.

    `reciprocity_error` and `repeat_noise` are relative, see `quality`. Guessing gives all contacts
    the mean place of those of the validation split, and has the figures of `GUESS`: the median over
    touches of the mean over contacts, and of single presses those of a method.
    `guess_force_n` and `guess_load_percent` are the errors of always guessing the mean load of the
    validation split. None where not defined.
    """
    found = quality(read_recording(scenario.recording), scenario.nominal_sensor.pattern)
    values = dict(zip(NOTES, found, strict=False))
    if scenario.recorded_set.truth == "position":
        values |= _guess(scenario, n)
    values |= _guessed_loads(scenario, n)
    return {
        name: value if (value := values.get(name)) is not None and np.isfinite(value) else None
        for name in NOTES
    }


def _guess(scenario: RecordedScenario, n: int) -> dict[str, float]:
    known = contact_places(load(scenario, "validation").samples)
    presses = contact_places(load(scenario, "test", n).samples)
    away = 1e3 * np.linalg.norm(presses - np.nanmean(known, axis=(0, 1)), axis=2)
    if presses.shape[1] > 1:
        return {"guess_mm": float(np.nanmedian(np.nanmean(away, axis=1)))}
    columns = {"localisation_mm": away[:, 0]}
    columns |= {f"expected_{axis}_m": presses[:, 0, k] for k, axis in enumerate("xy")}
    cell = pd.DataFrame(columns)
    return {name: figure_of(cell, METRICS[of]) for name, of in GUESS.items()}


def _guessed_loads(scenario: RecordedScenario, n: int) -> dict[str, float]:
    """As the metrics `measured_force_error_n` and `measured_load_error_percent`."""
    known = load(scenario, "validation", REGISTRATION_FRAMES).samples  # as those of methods
    mean = fit_load(known, np.zeros(len(known)))  # images that say nothing
    if mean is None:
        return {}
    tested = load(scenario, "test", n).samples
    error = float(np.nanmedian(mean.error(np.zeros(len(tested)), tested)))
    force = {"guess_force_n": error} if mean.quantity == "force_N" else {}
    return force | {"guess_load_percent": 100 * error / mean.full_scale}
