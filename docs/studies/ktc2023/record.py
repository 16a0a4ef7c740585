"""The record of the suite `ktc2023`, from stored runs.

`python docs/studies/ktc2023/record.py RUN...` writes `ktc2023.json`, of which `make tables` makes
the table of docs/results/ktc2023.md. Further methods join with a run of their own.
"""

import json
import re
import sys
from pathlib import Path

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run

OUT = Path(__file__).resolve().parent / "ktc2023.json"
_COLUMNS = (
    "suite", "scenario", "method", "track", "run", "n", "coverage", "ktc_score", "cc", "iou",
    "localisation_mm", "setup_s", "data_hash",
)  # fmt: skip


def write(paths: list[Path]) -> None:
    """Write the record of run directories."""
    runs = [read_run(path) for path in paths]
    about = [
        {
            "run": run.path.name,
            "command": re.sub(r" --(out|jobs) \S+", "", run.manifest["command_line"]),
            **{name: run.manifest[name] for name in ("started", "git_commit", "versions")},
            "cpu": run.manifest["machine"]["cpu"],
            "data": {name: data["hash"] for name, data in run.manifest["data"].items()},
            "weights": sorted({of["weights"] for of in run.manifest["cells"] if of["weights"]}),
        }
        for run in runs
    ]
    rows = [{name: row[name] for name in _COLUMNS} for row in leaderboard_rows(runs)]
    OUT.write_text(json.dumps({"runs": about, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
