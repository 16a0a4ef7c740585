"""The record and the figure of the suite `acuity`, from a stored run.

`python docs/studies/acuity/record.py RUN` takes a run directory, and writes its table and command
to `docs/studies/acuity` and the maps of one method to `docs/acuity.png`.
"""

import json
import shutil
import sys
from pathlib import Path

from eitbench.benchmark.analysis.results import read_run

OUT = Path(__file__).resolve().parent
METHOD = "noser"
_RUN = ("started", "git_commit", "versions", "threads", "data")


def write(run: Path) -> None:
    """Write record and figure."""
    suite = read_run(run)
    methods = ",".join(dict.fromkeys(suite.samples["method"]))
    about = {"command": f"eitbench run acuity --methods {methods}"}
    about |= {name: suite.manifest.get(name) for name in _RUN}
    (OUT / "run.json").write_text(json.dumps(about, indent=1) + "\n")
    for name in ("acuity.csv", "acuity.md"):
        shutil.copy(run / name, OUT / name)
    shutil.copy(run / "figures" / f"acuity-{METHOD}.png", OUT.parents[1] / "acuity.png")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
