"""Measures what averaging over the symmetries of `foam16` is worth and costs.

Run: python docs/studies/symmetries/measure.py SAMPLES OUT.csv

The first SAMPLES of the validation split of `paper` (half clean, the others from 30 to 60 dB)
are reconstructed by every trained method with all symmetries of the sensor and with the identity
alone. `psnr_one` and `psnr` are the mean PSNR [dB] without and with, `gain` is the mean difference
with its 95 % interval over sessions, `ms_one` and `ms` are the processor's time for a frame, one
thread, in batches, and `weights` the SHA-256 of the weights.
"""

import sys
import time

import pandas as pd
import torch

from eitbench import __version__, load
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.metrics.statistics import bootstrap
from eitbench.methods import Problem, create
from eitbench.methods.learned.image_networks import TrainedMethod
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset

METHODS = ("dnn", "phydnn", "coarse-to-fine", "learned-gn")


def scored(method: TrainedMethod, data: Dataset) -> tuple[Array, float]:
    """PSNR (n,) [dB] of a method on data, and its time for a frame [ms]."""
    problem = method._problem
    start = time.process_time()
    images = reconstructed(method, problem, data)
    spent = time.process_time() - start
    return evaluate(data, images)["psnr"].to_numpy(), 1e3 * spent / len(data)


def main(count: int, out: str) -> None:
    """Write the record."""
    torch.set_num_threads(1)
    data = load("paper", split="validation", limit=count)
    clusters = data.samples["cluster"]
    rows = []
    for name in METHODS:
        method = create(name)
        assert isinstance(method, TrainedMethod)
        method.fit(Problem(data.sensor, data.references[0], no_split))
        psnr, ms = scored(method, data)
        for part in (method, getattr(method, "_first", method)):
            part._motions = part._motions[:1]
        alone, ms_alone = scored(method, data)
        (gain,) = bootstrap((psnr - alone)[:, None], clusters)
        rows.append({
            "method": name, "n": count, "psnr_one": alone.mean(), "psnr": psnr.mean(),
            "gain": gain.value, "gain_low": gain.low, "gain_high": gain.high,
            "ms_one": ms_alone, "ms": ms, "weights": method.weights_hash(data.sensor)[:16],
            "data": data.data_hash[:16], "eitbench": __version__,
        })  # fmt: skip
        print(rows[-1], flush=True)
    pd.DataFrame(rows).to_csv(out, index=False, float_format="%.6g")


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
