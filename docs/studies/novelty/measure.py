"""When not to trust an image: figures from runs of the suite `novelty`.

`python -m docs.studies.novelty.measure RUN...` reads runs, writes how well every score tells every
condition to `novelty.csv`, the figures of images under each condition to `images.csv`, commands and
versions of the runs to `runs.json`, and draws `docs/novelty.png`. Samples that several runs have
count once, as the first of the runs has them.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from docs.tables.record import DOCS, STUDIES, about_runs

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.findings.novelty import read_novelty
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.findings.novelty import draw, to_table

OUT = STUDIES / "novelty"


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories, and the figure."""
    runs = [read_run(path) for path in paths]
    samples = pd.concat([run.samples for run in runs])
    samples = samples.drop_duplicates(["scenario", "method", "sample"])
    cells = pd.concat([run.cells for run in runs]).drop_duplicates(["scenario", "method"])
    found = read_novelty(replace(runs[0], samples=samples, cells=cells))
    images = samples.groupby(["scenario", "method"], sort=False).agg(
        n=("sample", "size"), psnr=("psnr", "mean")
    )
    for table, name in ((to_table(found), "novelty"), (images.reset_index(), "images")):
        table.to_csv(OUT / f"{name}.csv", index=False, float_format="%.6g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")
    with mpl.rc_context(STYLE):
        save(draw(found), DOCS / "novelty", ("png",))


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
