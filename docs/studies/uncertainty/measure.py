"""What methods state of their uncertainty: figures from runs.

`python -m docs.studies.uncertainty.measure RUN...` reads runs, writes the figures of every method
and scenario to `uncertainty.csv`, commands and versions of the runs to `runs.json`, and draws
`docs/uncertainty.png` from those with true images.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from docs.tables.record import DOCS, STUDIES, about_runs

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.findings.uncertainty import read_uncertainty
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.findings.uncertainty import draw, to_table

OUT = STUDIES / "uncertainty"


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories, and the figure."""
    runs = [read_run(path) for path in paths]
    found = [one for run in runs for one in read_uncertainty(run)]
    # A method that several runs have counts once, as the first has it; the best ones come first.
    found = list({(one.scenario, one.method): one for one in reversed(found)}.values())
    order = list(dict.fromkeys(name for run in runs for name in run.scenarios()))
    found.sort(key=lambda one: (order.index(one.scenario), one.figures["crps"].value))
    table: pd.DataFrame = to_table(found)
    table.to_csv(OUT / "uncertainty.csv", index=False, float_format="%.6g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")
    with mpl.rc_context(STYLE):
        save(draw([one for one in found if one.curves is not None]), DOCS / "uncertainty", ("png",))


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
