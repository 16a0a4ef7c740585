"""Do networks find presses on a real skin better if they learned from skins with imperfections?

    python docs/studies/real-skin-training/measure.py WORK errors.csv

Networks for `ohmc16` learn from simulated presses on the nominal skin, on skins with other
electrodes, contacts and gains (suite `imperfect-presses`), or on such as drift too, on boards with
faults and old reference frames (`all-imperfections.toml`). Each then finds the validation presses
of the real skin, with the gains of measurements taken out, and with frames amplified as is best of
what is tried; so do the packaged networks. Places are registered by a similarity, in five parts:
each is judged with the similarity of the other four. No test press is read. WORK keeps the
trainings; a stopped one goes on.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench import __version__
from eitbench.benchmark.tuning.selection import selected_parameters
from eitbench.methods.learned.image_networks import NETWORKS
from eitbench.methods.problem import Problem, no_split
from eitbench.methods.registry import create
from eitbench.methods.training import TrainingRequest, train
from eitbench.scenarios import load_suite, sensor
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import registered_in_parts

SKIN = "ohmc16"
LEARNED_FROM = {
    "nominal": ("presses", 0.0),
    "uneven": ("imperfect-presses", 1.0),
    "all imperfections": (str(Path(__file__).with_name("all-imperfections.toml")), 1.0),
}
"""The suite, and the power of the gains that are taken out of training frames."""
TRAININGS = {
    "dnn": {"epochs": 30, "operator": "jacobian"},
    "coarse-to-fine": {"epochs": 12, "loss": "log-mse"},
    "latent-flow": {"epochs": 20},
}
CLASSICAL = ("greit", "noser")
"""For comparison, with the parameters that are selected on these presses."""


def errors(name: str, **parameters: object) -> Array:
    """Errors (n,) [mm] of the validation presses; NaN where nothing is found."""
    presses, skin = read_recording(SKIN).without_test(), sensor(SKIN)
    method = create(name, **{"gain_power": 1.0} | parameters)
    method.fit(Problem(skin, presses.reference, no_split))
    found = locate(np.minimum(method.reconstruct(presses.voltages) - skin.background, 0), skin)
    return 1e3 * registered_in_parts(found, presses.samples[["x_m", "y_m"]].to_numpy())


def amplified(name: str, **parameters: object) -> tuple[Array, dict[str, float]]:
    """The `errors` with the least median, with their amplification and those without one."""
    tried = {a: errors(name, amplification=a, **parameters) for a in NETWORKS["amplification"]}
    best = min(tried, key=lambda a: float(np.nanmedian(tried[a])))
    plain = round(float(np.nanmedian(tried[1.0])), 2)
    return tried[best], {"amplification": best, "not_amplified_mm": plain}


def row(method: str, learned_from: str, error: Array, **more: object) -> dict[str, object]:
    """A row of the table."""
    made = {
        "method": method, "learned_from": learned_from, **more, "n": len(error),
        "median_mm": round(float(np.nanmedian(error)), 2),
        "p90_mm": round(float(np.nanpercentile(error, 90)), 2),
    }  # fmt: skip
    print(made, flush=True)
    return made


if __name__ == "__main__":
    work, rows = Path(sys.argv[1]), []
    (presses,) = (s for s in load_suite("presses").scenarios if s.name == SKIN)
    for name in CLASSICAL:
        rows.append(row(name, "", errors(name, **selected_parameters(presses, name))))
    for name, how in TRAININGS.items():
        error, best = amplified(name)
        rows.append(row(name, "as packaged", error, **best))
        for learned_from, (suite, gain_power) in LEARNED_FROM.items():
            out = work / f"{name}-{learned_from.replace(' ', '-')}"
            request = TrainingRequest(
                name, suite, gain_power=gain_power, out=out, install="never", **how
            )
            trained = train(request)
            curve = json.loads((trained.weights.with_suffix(".json")).read_text())
            error, best = amplified(name, weights=str(trained.weights))
            spent = {"epochs": int(curve["epochs"]), "train_s": round(float(curve["train_s"]))}
            rows.append(row(name, learned_from, error, **best, **spent))
    pd.DataFrame(rows).assign(version=__version__).to_csv(
        Path(sys.argv[2]), index=False, lineterminator="\n"
    )
