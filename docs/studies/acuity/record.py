"""The record and the figures of the suite `acuity`, from a stored run.

`python docs/studies/acuity/record.py RUN` takes a run directory, and writes its tables and command
to `docs/studies/acuity`, and to `docs` the maps of one method and GREIT's figures of merit.
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
    for name in ("acuity.csv", "acuity.md", "acuity-merit.csv", "acuity-merit.md"):
        shutil.copy(run / name, OUT / name)
    for name, to in ((f"acuity-{METHOD}", "acuity"), ("acuity-merit", "acuity-merit")):
        shutil.copy(run / "figures" / f"{name}.png", OUT.parents[1] / f"{to}.png")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
