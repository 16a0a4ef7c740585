"""What the posterior of a frame holds on each rung of `sim2real`: shapes, and images of them.

`python -m docs.studies.rungs.measure DIR [SAMPLES]` reads the draws that `eitbench ceiling sim2real
--samples 72 --out DIR` has made. It writes a row for each frame at 70 dB that has draws to
`rungs.csv`, and what made them to `rungs.json`.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from docs.tables.record import STUDIES

from eitbench.benchmark.ceiling.drawing import (
    CLEAN_DB,
    VERSION,
    Posterior,
    draws_of,
    known_of,
    priors_of,
    told,
)
from eitbench.benchmark.ceiling.models import images
from eitbench.benchmark.rundir.manifest import environment
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import load_suite

OUT = STUDIES / "rungs"
DOUBT = 0.05
"""A pixel is in doubt where the probability that it is touched lies this far from 0 and from 1."""


def held(posterior: Posterior, families: list[Parameters]) -> dict[str, float]:
    """What the draws of both samplers together hold.

    Columns: `images`, how many sets of touched pixels their weights are worth; `doubted`, the
    number of pixels in doubt; `place_mm`, root mean square deviation of the centre of the likeliest
    family's (first) shape, a parameter of it, from its mean.
    """
    drawn = posterior.draws.values()
    family = np.concatenate([of.families for of in drawn]).astype(int)
    vectors = np.concatenate([of.vectors for of in drawn]).astype(float)
    weights = np.concatenate([of.weights / of.weights.sum() for of in drawn]) / len(drawn)
    painted = images(families, family, vectors).reshape(len(family), -1)
    _, which = np.unique(np.packbits(painted != 1, axis=1), axis=0, return_inverse=True)
    alike = np.bincount(which.ravel(), weights)
    touched = weights @ (painted != 1)
    likeliest = family == np.bincount(family, weights).argmax()
    share = weights[likeliest] / weights[likeliest].sum()
    centres = 1e3 * families[0].side * vectors[likeliest, :2]
    return {
        "images": float(1 / (alike @ alike)),
        "doubted": float(np.count_nonzero((touched > DOUBT) & (touched < 1 - DOUBT))),
        "place_mm": float(np.sqrt(share @ ((centres - share @ centres) ** 2).sum(axis=1))),
    }


def rows_of(scenario: SimulatedScenario, folder: Path, samples: int) -> list[dict[str, object]]:
    """The rows of one scenario."""
    data = load(scenario, "test", samples)
    families = [prior.parameters for prior in priors_of(scenario)]
    found = []
    for sample, input_hash in enumerate(data.frame_hashes):
        posterior = draws_of(folder, scenario.name, sample, input_hash)
        if posterior is not None:
            about = {"scenario": scenario.name, "sample": sample}
            found.append({**about, **held(posterior, families)})
    return found


def write(folder: Path, samples: int) -> None:
    """Write the record."""
    known, _ = known_of(load_suite("sim2real").scenarios)
    scenarios = [of for of in map(told, known) if of.noise.test == CLEAN_DB]
    table = pd.DataFrame([row for of in scenarios for row in rows_of(of, folder, samples)])
    table.to_csv(OUT / "rungs.csv", index=False, float_format="%.6g", lineterminator="\n")
    command = f"python -m docs.studies.rungs.measure DIR {samples}"
    about = {"command": command, "sampler": VERSION, **environment()}
    (OUT / "rungs.json").write_text(json.dumps(about, indent=1) + "\n")


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]) if sys.argv[2:] else 72)
