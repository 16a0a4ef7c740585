"""Measures what further training samples are worth at equal work, and draws quality over hours.

Run: python docs/studies/data/measure.py FOLDER OUT.csv OUT.png

Trains `dnn` anew on the first samples of the training set of `paper`, or on new ones in every
epoch, in FOLDER (a stopped run continues). Every training may see 192,000 samples, each under a
random symmetry and with noise drawn anew: small sets are seen more often. It ends early if its
validation loss gets no better for 25 epochs; `each_seen` says how often samples were seen. `psnr`
and its 95 % interval are of the first 600 test samples, `gain` is the mean difference to the
training on 24,000.

The figure shows them over the number of samples, and beside them, from the learning curves that
come with the packaged weights, the validation loss of every method over the hours of its training,
those of the network that it begins with included. Validation frames are half noisy.
"""

import json
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import torch

from eitbench import __version__, load
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.metrics.statistics import bootstrap
from eitbench.methods import Problem
from eitbench.methods.learned.image_networks import Dnn
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.methods.training import TrainingRequest, train
from eitbench.methods.weights.weight_files import packaged_weights
from eitbench.reports.figures.style import NOTE, PAGE, STYLE, line_style, new_figure, save
from eitbench.scenarios.arrays import Array

SEEN, PUBLISHED, TESTED = 192_000, 24_000, 600
COUNTS = (750, 1500, 6000, 12_000, PUBLISHED)
CURVES = {
    "dnn": "", "phydnn": "", "learned-proximal": "", "fno": "", "coarse-to-fine": "",
    "learned-gn": "dnn",
}  # fmt: skip
"""Methods that were trained with the mean squared error, and what each begins with."""


def measure(folder: Path) -> pd.DataFrame:
    """Return a row for every number of training samples."""
    torch.set_num_threads(1)
    data = load("paper", limit=TESTED)
    rows, found = [], {}
    for count in (*COUNTS, SEEN):
        unlimited = count == SEEN
        request = TrainingRequest(
            "dnn", "paper",
            epochs=SEEN // PUBLISHED if unlimited else SEEN // count,
            limit=None if unlimited else count,
            unlimited=unlimited, device="cpu", install="never",
            out=folder / ("unlimited" if unlimited else str(count)),
        )  # fmt: skip
        result = train(request)
        method, problem = Dnn(str(result.weights)), Problem(
            data.sensor, data.references[0], no_split
        )  # fmt: skip
        method.fit(problem)
        epochs = len(json.loads(result.weights.with_suffix(".json").read_text())["curve"])
        found[count] = evaluate(data, reconstructed(method, problem, data))["psnr"].to_numpy()
        rows.append({
            "samples": count, "each_seen": 1 if unlimited else epochs,
            "validation": result.validation_loss, "train_h": method.train_s / 3600,
            "n": len(data), "data": data.data_hash[:16], "eitbench": __version__,
        })  # fmt: skip
        print(rows[-1], flush=True)
    clusters = data.samples["cluster"]

    names = ("psnr", "low", "high", "gain", "gain_low", "gain_high")
    for row in rows:
        psnr = found[row["samples"]]
        figures = bootstrap(np.stack([psnr, psnr - found[PUBLISHED]], axis=1), clusters)
        row |= dict(zip(names, (*figures[0], *figures[1]), strict=True))
    return pd.DataFrame(rows)


def curve(name: str) -> tuple[Array, Array]:
    """Hours (n,) of training, and the validation loss (n,) that was the least by then."""
    (path,) = packaged_weights().glob(f"{name}-foam16-*.json")
    stored = json.loads(path.read_text())
    epochs = pd.DataFrame(stored["curve"])
    begun = curve(CURVES[name])[0][-1] if CURVES[name] else 0.0
    hours = begun + np.cumsum(epochs["seconds"].to_numpy()) / 3600
    return hours, np.minimum.accumulate(epochs["validation"].to_numpy())


def draw_figure(table: pd.DataFrame, path: Path) -> None:
    """Draw PSNR over samples, and validation PSNR over hours."""
    figure = new_figure(PAGE, 3.0)
    left, right = figure.subplots(1, 2)
    spread = [table["psnr"] - table["low"], table["high"] - table["psnr"]]
    left.errorbar(
        table["samples"], table["psnr"], spread, **line_style(0), ms=3.5, lw=1.1, capsize=2.5
    )
    left.set_xscale("log")
    left.set_xticks(table["samples"], [f"{n:,}" for n in table["samples"]], rotation=45)
    left.minorticks_off()
    left.set_xlabel("training samples, up to 192,000 seen in all")
    left.set_ylabel("PSNR on clean test samples [dB]")
    for k, name in enumerate(CURVES):
        hours, loss = curve(name)
        # The first epochs of `phydnn` are those of `dnn`: their markers take turns.
        every = (3, 6) if name == "phydnn" else 6
        right.plot(
            hours, -10 * np.log10(loss), **line_style(k), markevery=every, ms=3.5, lw=1.1,
            label=name,
        )  # fmt: skip
    right.set_xscale("log")
    right.set_xticks([0.05, 0.1, 0.2, 0.5, 1, 2], ["0.05", "0.1", "0.2", "0.5", "1", "2"])
    right.minorticks_off()
    right.set_xlabel("hours of training on one core")
    right.set_ylabel("PSNR of the mean error,\nvalidation samples [dB]")
    right.legend(fontsize=NOTE)
    for axes in (left, right):
        axes.grid(visible=True, alpha=0.3)
    save(figure, path.with_suffix(""), formats=("png",))


if __name__ == "__main__":
    found = measure(Path(sys.argv[1]))
    found.to_csv(sys.argv[2], index=False, float_format="%.6g", lineterminator="\n")
    with mpl.rc_context(STYLE):
        draw_figure(found, Path(sys.argv[3]))
