"""The records and figures of the suites `drift` and `two-touch`, from stored runs.

`python docs/touches.py DRIFT TWO_TOUCH SUPERPOSITION` takes two run directories and the folder of
the study of superposition, and writes `docs/studies/drift`, `docs/studies/two-touch` and the
figures of docs/results/skin-drift.md and docs/results/two-touch.md.
"""

import json
import shutil
import sys
from pathlib import Path

import matplotlib as mpl
import pandas as pd

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.figures.style import STYLE, save
from eitbench.reports.figures.touches import panels

DOCS = Path(__file__).resolve().parent
_RUN = ("started", "git_commit", "versions", "threads", "data")


def write(drift: Path, two_touch: Path, superposition: Path) -> None:
    """Write both records and figures."""
    for run, names in ((drift, ("over-time.csv", "alarms.csv")), (two_touch, ("two-touch.csv",))):
        suite = read_run(run).manifest
        out = DOCS / "studies" / suite["plan"]["suite"]["name"]
        out.mkdir(parents=True, exist_ok=True)
        about = {"command": f"eitbench run {out.name}", **{name: suite.get(name) for name in _RUN}}
        (out / "run.json").write_text(json.dumps(about, indent=1) + "\n")
        for name in names:
            shutil.copy(run / name, out / name)
    shutil.copy(superposition / "superposition.json", DOCS / "studies" / "two-touch")
    with mpl.rc_context(STYLE):
        course = pd.read_csv(DOCS / "studies" / "drift" / "over-time.csv")
        x_label = "fifth of the presses, in order of time"
        figure = panels(course, "part", "error_mm", x_label, "error [mm]")
        save(figure, DOCS / "skin-drift", ("png",))
        apart = apart_by_all()
        pairs = apart[apart["apart"].notna()]
        x_label = "distance of the two touches [mm]"
        figure = panels(pairs, "distance_mm", "apart", x_label, "share told apart", highest=1.02)
        save(figure, DOCS / "two-touch", ("png",))


def apart_by_all() -> pd.DataFrame:
    """Shares told apart by the methods of the suite, and by the fit of two presses."""
    folder = DOCS / "studies" / "two-touch"
    fitted = json.loads((folder / "superposition.json").read_text())["told_apart"]
    return pd.concat([pd.read_csv(folder / "two-touch.csv"), pd.DataFrame(fitted)])


if __name__ == "__main__":
    write(*map(Path, sys.argv[1:]))
