"""Measures what the logarithm in the loss is worth, with three seeds.

Run: python docs/studies/loss/measure.py FOLDER OUT.csv

Trains the small network of `dnn` on the first 1,500 training samples of `paper` for 8 epochs, with
either loss and three seeds, in FOLDER (a stopped run continues). `psnr` is the mean PSNR [dB] over
the 1,200 validation samples, `clean` over those without noise, of one image for each frame: nothing
is averaged over symmetries.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from eitbench import __version__, load
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.methods import Problem
from eitbench.methods.learned.image_networks import Dnn
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.methods.training import TrainingRequest, train

BASE = TrainingRequest(
    "dnn", "paper", epochs=8, limit=1500, backbone="unet-small", device="cpu", install="never"
)


def main(folder: Path, out: str) -> None:
    """Write the record."""
    torch.set_num_threads(1)
    data = load("paper", split="validation")
    clean = np.isnan(data.samples["snr_db"].to_numpy())
    rows = []
    for seed in range(3):
        for loss in ("mse", "log-mse"):
            request = TrainingRequest(**{
                **vars(BASE), "seed": seed, "loss": loss, "out": folder / f"{loss}-{seed}"
            })  # fmt: skip
            method = Dnn(str(train(request).weights))
            problem = Problem(data.sensor, data.references[0], no_split)
            method.fit(problem)
            method._motions = method._motions[:1]
            psnr = evaluate(data, reconstructed(method, problem, data))["psnr"].to_numpy()
            rows.append({
                "loss": loss, "seed": seed, "psnr": psnr.mean(), "clean": psnr[clean].mean(),
                "command": request.command(8), "n": len(data), "data": data.data_hash[:16],
                "eitbench": __version__,
            })  # fmt: skip
            print(rows[-1], flush=True)
    pd.DataFrame(rows).to_csv(out, index=False, float_format="%.6g")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
