"""The record of the boards `noise` and `shapes`, from stored runs.

`python -m docs.studies.noise.record RUN...` writes the mean figures of every method on every
scenario to `boards.csv` (`psnr_of_mean` is the PSNR of the mean squared error), and commands and
versions to `runs.json`. Samples that several runs have count once, as the first of the runs has
them.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from docs.tables.record import about_runs, psnr_of_mean

from eitbench.benchmark.analysis.results import read_run

OUT = Path(__file__).resolve().parent
FIGURES = ["ssim", "cc", "rie", "psnr"]


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories."""
    runs = [read_run(path) for path in paths]
    samples = pd.concat([run.samples for run in runs])
    samples = samples.drop_duplicates(["scenario", "method", "sample"])
    of = samples.groupby(["scenario", "method"], sort=False)
    table = of[FIGURES].mean().join(of["psnr"].median().rename("psnr_median"))
    table = table.join(of["psnr"].agg(psnr_of_mean).rename("psnr_of_mean"))
    table = table.join(of["frame_ms"].median()).join(of.size().rename("n")).reset_index()
    table.to_csv(OUT / "boards.csv", index=False, float_format="%.6g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
