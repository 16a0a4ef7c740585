"""The record of the suite `skins`: figures, the board over skins and the maps, from stored runs.

`python docs/skins.py RUN...` writes `docs/studies/skins` anew, of which `make tables` makes the
tables of docs/results/skins.md. Further methods join with a run of their own.
"""

import json
import sys
from pathlib import Path

import matplotlib as mpl
import pandas as pd

from eitbench.benchmark.analysis.results import GUESS
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.page.paper import suite_maps
from eitbench.reports.page.report_data import report_data, rows_of

OUT = Path(__file__).resolve().parent / "studies" / "skins"
_FIGURES = (*GUESS.values(), "localisation_mm_low", "localisation_mm_high", *GUESS)
_COLUMNS = ("scenario", "method", "track", "group", "n", "coverage", "data_hash", *_FIGURES)
_RUN = ("started", "git_commit", "versions", "machine", "threads")


def write(runs: list[Path]) -> None:
    """Write the record of run directories."""
    report = report_data(runs)
    rows = [{name: row[name] for name in _COLUMNS} for row in rows_of(report["boards"])]
    OUT.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(OUT / "skins.csv", index=False, float_format="%.5g")
    about = {
        "command": "eitbench run skins",
        "runs": [{name: run[name] for name in _RUN} for run in report["runs"]],
        "overall": report["overall"]["||"],
    }
    (OUT / "skins.json").write_text(json.dumps(about, indent=1) + "\n")
    with mpl.rc_context(STYLE):
        for _, figure in suite_maps(report):
            save(figure, OUT / "maps", ("svg",))


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
