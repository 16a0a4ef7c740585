"""The record of the command `eitbench latency`, from its output.

`python docs/studies/latency/record.py DIR...` takes folders that `eitbench latency --out` wrote.
It writes their tables and settings to `docs/studies/latency`, the figure of the first to
`docs/latency.png`.
"""

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

OUT = Path(__file__).resolve().parent


def write(folders: Sequence[Path]) -> None:
    """Write record and figure."""
    tables, runs = [], []
    for folder in folders:
        about = json.loads((folder / "latency.json").read_text())
        methods = ",".join(dict.fromkeys(row["method"] for row in about.pop("methods")))
        table = pd.read_csv(folder / "latency.csv")
        for name in ("reference_age_s", "snr_db"):
            table.insert(0, name, about[name])
        tables.append(table)
        command = (
            f"eitbench latency {about['sensor']} --snr {about['snr_db']:g} --methods {methods} "
            f"--touches {about['touches']} --reference-age {about['reference_age_s']:g} "
            f"--seed {about['seed']}"
        )
        runs.append({"command": command} | about)
    pd.concat(tables).to_csv(OUT / "latency.csv", index=False, lineterminator="\n")
    (OUT / "run.json").write_text(json.dumps(runs, indent=1) + "\n")
    shutil.copy(folders[0] / "latency.png", OUT.parents[1] / "latency.png")


if __name__ == "__main__":
    write([Path(folder) for folder in sys.argv[1:]])
