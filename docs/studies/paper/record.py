"""The record of clean frames from the mesh that methods invert with, from stored runs of `paper`.

`python -m docs.studies.paper.record RUN...` writes a row for every method of the runs to
`paper.csv`: means over all its samples of the scenario, and over the first 600. A mean PSNR rewards
images that are right to the pixel without bound, so that the median stands beside it, and
`psnr_of_mean`, the PSNR of the mean squared error. `gain` is the mean PSNR minus that of `dnn` on
the same samples, with its 95 % interval. Rows of other methods and numbers of samples stay: those
of a method that has changed are to be deleted before.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from docs.tables.record import about_runs, psnr_of_mean

from eitbench.benchmark.analysis.results import read_run

OUT = Path(__file__).resolve().parent
FIGURES = ["ssim", "cc", "rie", "psnr"]
FIRST = 600
BASE = "dnn"


def figures(samples: pd.DataFrame, base: pd.Series) -> dict[str, object]:
    """Return the figures of a method from its rows `samples`, and the PSNR of `BASE` by sample."""
    psnr = samples.set_index("sample")["psnr"]
    gain = (psnr - base.reindex(psnr.index)).to_numpy()
    error = 1.96 * gain.std(ddof=1) / np.sqrt(len(gain))
    return {
        "n": len(samples),
        **samples[FIGURES].mean(),
        "psnr_median": psnr.median(),
        "psnr_of_mean": psnr_of_mean(psnr),
        "frame_ms": samples["frame_ms"].median(),
        "gain": gain.mean(),
        "gain_low": gain.mean() - error,
        "gain_high": gain.mean() + error,
    }


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories; samples that several runs have count once."""
    runs = [read_run(path) for path in paths]
    rows = pd.concat([run.samples for run in runs])
    rows = rows[rows["scenario"] == "paper"].drop_duplicates(["method", "sample"])
    base = rows[rows["method"] == BASE].set_index("sample")["psnr"]
    found = []
    for method, of in rows.groupby("method"):
        for part in (of, of[of["sample"] < FIRST]):
            found.append({"scenario": "paper", "method": method, **figures(part, base)})
    table = pd.DataFrame(found).drop_duplicates(["method", "n"])
    path = OUT / "paper.csv"
    stored = pd.read_csv(path)
    table = pd.concat([table, stored]).drop_duplicates(["method", "n"])
    table = table.sort_values(["n", "psnr"], ascending=False)
    table.to_csv(path, index=False, float_format="%.6g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
