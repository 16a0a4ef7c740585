"""The record of networks that are fitted to each frame, from stored runs.

`python -m docs.studies.per-frame.record RUN...` writes the mean figures of every method on every
scenario of the runs to `figures.csv`, and their commands and versions to `runs.json`. `frame_ms` is
the median time of a single frame.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from docs.tables.record import about_runs

from eitbench.benchmark.analysis.results import read_run

OUT = Path(__file__).resolve().parent
FIGURES = ["ssim", "cc", "rie", "psnr"]


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories."""
    runs = [read_run(path) for path in paths]
    samples = pd.concat([run.samples for run in runs])
    of = samples.groupby(["suite", "scenario", "method"], sort=False)
    table = of[FIGURES].mean().join(of["frame_ms"].median()).join(of.size().rename("samples"))
    table.to_csv(OUT / "figures.csv", float_format="%.5g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
