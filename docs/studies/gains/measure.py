"""What gains of measurements are worth on the presses of `ohmc16`, for each method.

    python docs/studies/gains/measure.py BEFORE.json docs/studies/gains/presses.csv

BEFORE.json is the record of parameters that were selected while no method took gains out
(`benchmark/tuning/selected/fcc0e04f1470426d.json` of commit 4a2e35d); `with` has those that are
selected now. Methods of `LEARNED` have since learned from frames with the gains taken out, which is
their row `learned`; their other rows are of commit 64906f7, and are kept. `amplified` has the
amplification of frames that is selected for networks, the others have none. Places are registered
on the 100 validation presses, and 400 test presses judge, as on the board of the suite `presses`.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench import __version__
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods import Problem, create
from eitbench.scenarios import load
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import fit_similarity
from eitbench.scenarios.suites.suite import load_suite

METHODS = (
    "dnn", "phydnn", "coarse-to-fine", "noser", "laplacian", "greit", "tikhonov",
    "back-projection", "linear-touch", "learned-gn", "tv", "ensemble", "latent-flow",
)  # fmt: skip
LEARNED = ("linear-touch", "coarse-to-fine")
SUITE = {scenario.name: scenario for scenario in load_suite("presses").scenarios}


def press_error(method: str, parameters: Mapping[str, Any]) -> float:
    """Median error [mm] on the test presses."""
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
    return float(1e3 * np.nanmedian(np.hypot(*(register(found) - places)[~known].T)))


if __name__ == "__main__":
    choices = json.loads(Path(sys.argv[1]).read_text())["choices"]
    stored = pd.read_csv(sys.argv[2])
    kept = (stored["gains"] != "learned") & stored["method"].isin(LEARNED)
    rows = stored[kept].to_numpy().tolist()
    for name in METHODS:
        before = choices[name]["parameters"] if name in choices else {}
        now = selected_parameters(SUITE["ohmc16"], name) or {}
        plain = {key: value for key, value in now.items() if key != "amplification"}
        changed = {"learned": plain} if name in LEARNED else {"without": before, "with": plain}
        if now.get("amplification", 1.0) != 1.0:
            changed["amplified"] = now
        for gains, parameters in changed.items():
            error = round(press_error(name, parameters), 3)
            rows.append((name, gains, error, json.dumps(parameters), __version__))
            print(rows[-1], flush=True)
        columns = ["method", "gains", "localisation_mm", "parameters", "version"]
        table = pd.DataFrame(rows, columns=columns)  # after every method: some take minutes
        table.to_csv(Path(sys.argv[2]), index=False, lineterminator="\n")
