"""The record of the suites `new-skin`, `few-presses` and `presses`, from stored runs.

`python docs/new_skin.py new-skin RUN...` writes the errors of all runs on each skin into
`docs/studies/new-skin`, of which `make tables` makes the tables of docs/results/new-skin.md, and
the figure of that page; `few-presses` and `presses` write those of docs/results/skin.md. Of a cell
that several runs hold, the last one counts.
"""

import json
import re
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import pandas as pd

from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.analysis.standings import standings
from eitbench.benchmark.analysis.transfer import over_skins, skin_errors
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.figures.transfer import draw

DOCS = Path(__file__).resolve().parent
OUT = DOCS / "studies" / "new-skin"
_ERROR = ("localisation_mm", "localisation_mm_low", "localisation_mm_high")


def write(suite: str, paths: list[Path]) -> None:
    """Write the record of run directories of `suite`."""
    runs = [read_run(path) for path in paths]
    found = skin_errors(runs)
    # A median over some of the skins would stand beside those over all.
    skins = Counter((error.method, error.labelled) for error in found)
    errors = [e for e in found if skins[e.method, e.labelled] == max(skins.values())]
    table = pd.DataFrame(errors or _board(runs))
    table.to_csv(OUT / f"{suite}.csv", index=False, float_format="%.6g")
    known = json.loads((OUT / "runs.json").read_text())
    known[suite] = [
        {
            "command": re.sub(r" --(out|jobs) \S+", "", run.manifest["command_line"]),
            **{name: run.manifest[name] for name in ("git_commit", "versions")},
            "data": {name: data["hash"] for name, data in run.manifest["data"].items()},
        }
        for run in runs
    ]
    (OUT / "runs.json").write_text(json.dumps(known, indent=1) + "\n")
    if suite == "new-skin":
        with mpl.rc_context(STYLE):
            save(draw(over_skins(errors)), DOCS / "new-skin", ("png",))


def _board(runs: Sequence[Run]) -> list[dict[str, object]]:
    """The board of the set `ohmc16` in runs of a suite of imaging methods."""
    boards = (standing.rows for standing in standings(runs))
    (rows,) = (rows for rows in boards if rows[0]["scenario"] == "ohmc16")
    columns = ("method", "track", "n", "data_hash", *_ERROR, "group")
    return [{name: row[name] for name in columns} for row in rows]


if __name__ == "__main__":
    write(sys.argv[1], [Path(run) for run in sys.argv[2:]])
