"""What gains of measurements are worth on the presses of `ohmc16`, for each method.

    python docs/studies/gains/measure.py BEFORE.json docs/studies/gains/presses.csv

BEFORE.json is the record of parameters that were selected while no method took gains out
(`benchmark/tuning/selected/fcc0e04f1470426d.json` of commit 4a2e35d); `with` has those that are
selected now. Methods of `LEARNED` have since learned from frames with the gains taken out, which is
their row `learned`; their other rows are of commit 64906f7, and are kept. `amplified` has the
amplification of frames that is selected for networks, the others have none; `change_mm` is the
median change of the error by it, press by press, with its 95 % interval. Places are registered on
the 100 validation presses, and 400 test presses judge, as on the board of the suite `presses`.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench import __version__
from eitbench.benchmark.metrics.statistics import bootstrap, medians
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create
from eitbench.scenarios import load
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.suite import load_suite

METHODS = (
    "dnn", "phydnn", "coarse-to-fine", "noser", "laplacian", "greit", "tikhonov",
    "back-projection", "linear-touch", "learned-gn", "tv", "ensemble", "latent-flow",
)  # fmt: skip
LEARNED = ("linear-touch", "coarse-to-fine")
COLUMNS = [
    "method", "gains", "localisation_mm", "change_mm", "low_mm", "high_mm", "parameters", "version",
]  # fmt: skip
SUITE = {scenario.name: scenario for scenario in load_suite("presses").scenarios}


def press_errors(method: str, parameters: Mapping[str, Any]) -> Array:
    """Errors (n,) [mm] on the test presses."""
    recording, data = read_recording("ohmc16"), load(SUITE["ohmc16"], limit=1)
    problem = Problem(
        data.sensor,
        recording.reference,
        lambda split, limit: load(SUITE["presses"], split=split, limit=limit),
    )
    fitted = create(method, **parameters)
    fitted.fit(problem)
    found = locate(
        np.asarray(fitted.reconstruct(recording.voltages)) - problem.background, data.sensor
    )
    places = recording.samples[["x_m", "y_m"]].to_numpy()
    known = (recording.samples["split"] == "validation").to_numpy()
    register = fit_similarity(found[known], places[known])
    assert register is not None
    return 1e3 * np.hypot(*(register(found) - places)[~known].T)


if __name__ == "__main__":
    choices = json.loads(Path(sys.argv[1]).read_text())["choices"]
    stored = pd.read_csv(sys.argv[2])
    kept = stored["gains"].isin(("without", "with")) & stored["method"].isin(LEARNED)
    rows = stored[kept].to_dict("records")
    for name in METHODS:
        before = choices[name]["parameters"] if name in choices else {}
        now = selected_parameters(SUITE["ohmc16"], name) or {}
        plain = {key: value for key, value in now.items() if key != "amplification"}
        changed = {"learned": plain} if name in LEARNED else {"without": before, "with": plain}
        if now.get("amplification", 1.0) != 1.0:
            changed["amplified"] = now
        before_it = np.empty(0)
        for gains, parameters in changed.items():
            error = press_errors(name, parameters)
            row = {"method": name, "gains": gains, "parameters": json.dumps(parameters)}
            row |= {"localisation_mm": round(float(np.nanmedian(error)), 3), "version": __version__}
            if gains == "amplified":
                pressed = np.arange(len(error))
                (change,) = bootstrap((error - before_it)[:, None], pressed, medians)
                ends = {"change_mm": change.value, "low_mm": change.low, "high_mm": change.high}
                row |= {key: round(value, 2) for key, value in ends.items()}
            rows.append(row)
            before_it = error
            print(row, flush=True)
        table = pd.DataFrame(rows)[COLUMNS]  # after every method: some take minutes
        table.to_csv(Path(sys.argv[2]), index=False, lineterminator="\n")
