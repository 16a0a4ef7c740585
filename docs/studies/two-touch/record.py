"""The records and figures of the suites `drift` and `two-touch`, from stored runs.

`python docs/studies/two-touch/record.py DRIFT TWO_TOUCH SUPERPOSITION` takes two run directories
and the folder of the study of superposition, and writes `docs/studies/drift`,
`docs/studies/two-touch` and the figures of docs/results/skin-drift.md and two-touch.md.
"""

import json
import shutil
import sys
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.figures.style import COLOURS, COLUMN, NOTE, STYLE, new_figure, save
from eitbench.reports.findings.touches import panels

OUT = Path(__file__).resolve().parent
DOCS = OUT.parents[1]
FIT = "fit of two presses"
_RUN = ("started", "git_commit", "versions", "threads", "data")


def write(drift: Path, two_touch: Path, superposition: Path) -> None:
    """Write both records and figures."""
    for run, names in ((drift, ("over-time.csv", "alarms.csv")), (two_touch, ("two-touch.csv",))):
        suite = read_run(run).manifest
        out = OUT.parent / suite["plan"]["suite"]["name"]
        out.mkdir(parents=True, exist_ok=True)
        about = {"command": f"eitbench run {out.name}", **{name: suite.get(name) for name in _RUN}}
        (out / "run.json").write_text(json.dumps(about, indent=1) + "\n")
        for name in names:
            shutil.copy(run / name, out / name)
    shutil.copy(superposition / "superposition.json", OUT)
    with mpl.rc_context(STYLE):
        course = pd.read_csv(OUT.parent / "drift" / "over-time.csv")
        x_label = "fifth of the presses, in order of time"
        figure = panels(course, "part", "error_mm", x_label, "error [mm]")
        save(figure, DOCS / "skin-drift", ("png",))
        save(told_apart_figure(apart_by_all()), DOCS / "two-touch", ("png",), dpi=200)


def told_apart_figure(apart: pd.DataFrame) -> Figure:
    """A panel for each skin: the fit of two presses, the best image, and where all images lie."""
    figure = new_figure(COLUMN, 4.4)
    # Scenario, title, and where the labels of fit, best image and all images stand.
    skins = (
        ("superposed-pairs", "hydrogel disc", (43, 0.8), (40, 0.28), (88, 0.1)),
        ("superposed-pairs-cam09-05", "two-layer skin 05", (34, 0.76), (79, 0.9), (63, 0.4)),
    )
    frames = apart[apart["method"] == FIT]
    images = apart[(apart["method"] != FIT) & apart["apart"].notna()]
    for axes, (scenario, title, *places) in zip(figure.subplots(2, 1), skins, strict=True):
        shares = images[images["scenario"] == scenario].pivot(
            index="distance_mm", columns="method", values="apart"
        )
        best = shares.mean().idxmax()
        axes.fill_between(shares.index, shares.min(axis=1), shares.max(axis=1), color="0.85", lw=0)
        drawn = (
            (FIT, COLOURS[0], "fit of\ntwo presses"),
            (best, COLOURS[1], f"best image:\n{best}"),
        )
        for (method, colour, label), place in zip(drawn, places[:2], strict=True):
            of = apart[(apart["scenario"] == scenario) & (apart["method"] == method)]
            of = of[of["distance_mm"] > 0]
            error = [of["apart"] - of["low"], of["high"] - of["apart"]]
            axes.errorbar(
                of["distance_mm"], of["apart"], error, color=colour, marker="o", ms=3, lw=1.2,
                elinewidth=0.6,
            )  # fmt: skip
            axes.text(*place, label, color=colour, fontsize=NOTE, va="top")
        axes.text(*places[2], "all images", color="0.25", fontsize=NOTE)
        axes.set_title(title, loc="left")
        axes.set_ylim(-0.02, 1.05)
        axes.set_xlim(5, 113)
        axes.set_ylabel("share told apart")
        axes.grid(alpha=0.3, lw=0.4)
        if scenario == "superposed-pairs":
            real = frames[frames["scenario"] == "real-pairs"]
            axes.plot(
                real["distance_mm"], real["apart"], ls="", marker="D", ms=5, mfc="white",
                color=COLOURS[0], zorder=3,
            )  # fmt: skip
            axes.text(
                72, 0.5, "real pairs", color=COLOURS[0], fontsize=NOTE, ha="right", va="center"
            )
    axes.set_xlabel("distance of the two touches [mm]")
    return figure


def apart_by_all() -> pd.DataFrame:
    """Shares told apart by the methods of the suite, and by the fit of two presses."""
    fitted = json.loads((OUT / "superposition.json").read_text())["told_apart"]
    return pd.concat([pd.read_csv(OUT / "two-touch.csv"), pd.DataFrame(fitted)])


if __name__ == "__main__":
    write(*map(Path, sys.argv[1:]))
