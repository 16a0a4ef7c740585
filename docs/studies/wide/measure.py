"""Measures what channels are worth to a network that learns from as much as the published ones did.

Run on a GPU: python docs/studies/wide/measure.py FOLDER OUT.csv

Trains by the recipe of `dnn-large`, in 100 epochs of the 24,000 samples that `paper` declares, each
time under a random symmetry of the sensor and with other noise, in FOLDER (a stopped run
continues). Figures are of all clean test samples of `paper`, averaged over the sensor's symmetries
as the methods do.
"""

import json
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from eitbench import __version__, load
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.metrics.statistics import bootstrap
from eitbench.methods import Problem
from eitbench.methods.learned.image_networks import DnnLarge
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.methods.training import TrainingRequest, train

EPOCHS, SAMPLES = 100, 24_000
BACKBONES, SEEDS = ("unet-large", "unet"), (0, 1)
FIGURES = ("psnr", "ssim", "cc", "rie")


def measure(backbone: str, seed: int, folder: Path) -> dict[str, object]:
    """Train one network, and return its row."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    request = TrainingRequest(
        "dnn-large", "paper", epochs=EPOCHS, limit=SAMPLES, seed=seed, loss="log-mse",
        backbone=backbone, device=device, install="never", out=folder / f"{backbone}-{seed}",
    )  # fmt: skip
    weights = train(request).weights
    about = json.loads(weights.with_suffix(".json").read_text())
    data = load("paper")
    problem = Problem(data.sensor, data.references[0], no_split)
    method = DnnLarge(str(weights))
    method.fit(problem)
    method.to(device)
    scores = evaluate(data, reconstructed(method, problem, data))[list(FIGURES)]
    psnr, *others = bootstrap(scores.to_numpy(np.float64), data.samples["cluster"])
    return {
        "backbone": backbone, "samples": SAMPLES, "each_seen": EPOCHS, "seed": seed,
        "n": len(data), **dict(zip(("psnr", "low", "high"), psnr, strict=True)),
        **{name: of[0] for name, of in zip(FIGURES[1:], others, strict=True)},
        "best_epoch": about["best_epoch"], "train_s": about["train_s"],
        "device": about["device"], "command": about["command"],
        "train_data": about["train_data"][:16], "test_data": data.data_hash[:16],
        "torch": about["torch"], "eitbench": __version__,
    }  # fmt: skip


if __name__ == "__main__":
    rows = [measure(*one, Path(sys.argv[1])) for one in product(BACKBONES, SEEDS)]
    table = pd.DataFrame(rows)
    table.to_csv(sys.argv[2], index=False, float_format="%.6g", lineterminator="\n")
