"""The record of the suites `new-skin` and `few-presses`, from stored runs.

`python -m docs.studies.new-skin.record new-skin RUN...` writes the errors of all runs on each skin
into this folder, of which `make tables` makes the tables of docs/results/new-skin.md, and
the figure of that page; `few-presses` those of docs/results/skin.md. Of a cell that several runs
hold, the last one counts.
"""

import json
import sys
from collections import Counter
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from docs.tables.record import about_runs

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.findings.transfer import over_skins, skin_errors
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.findings.transfer import draw

OUT = Path(__file__).resolve().parent
DOCS = OUT.parents[1]


def write(suite: str, paths: list[Path]) -> None:
    """Write the record of run directories of `suite`."""
    runs = [read_run(path) for path in paths]
    found = skin_errors(runs)
    # A median over some of the skins would stand beside those over all.
    skins = Counter((error.method, error.labelled) for error in found)
    errors = [e for e in found if skins[e.method, e.labelled] == max(skins.values())]
    pd.DataFrame(errors).to_csv(OUT / f"{suite}.csv", index=False, float_format="%.6g")
    known = json.loads((OUT / "runs.json").read_text())
    known[suite] = about_runs(runs)
    (OUT / "runs.json").write_text(json.dumps(known, indent=1) + "\n")
    if suite == "new-skin":
        with mpl.rc_context(STYLE):
            save(draw(over_skins(errors)), DOCS / "new-skin", ("png",))


if __name__ == "__main__":
    write(sys.argv[1], [Path(run) for run in sys.argv[2:]])
