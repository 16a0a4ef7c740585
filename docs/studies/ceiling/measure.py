"""How far methods are below the ceiling, and what its posterior says of the sensor.

`python -m docs.studies.ceiling.measure RUN...` reads the record of the ceiling and runs of the
suite `noise`, writes the distance of every method at every level to `below.csv`, commands and
versions of the runs to `runs.json`, and draws `docs/ceiling.png` and `docs/ceiling-width.png`.
Samples that several runs have count once, as the first of the runs has them.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from docs.tables.ceiling import frames
from docs.tables.record import DOCS, STUDIES, about_runs
from matplotlib.figure import Figure

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.benchmark.findings.noise import noise_curves
from eitbench.reports.figures.style import PAGE, STYLE, line_style, new_figure, save
from eitbench.reports.findings.noise import draw

OUT = STUDIES / "ceiling"
GROUPS = 3
"""Equal groups of frames that a curve has a point for."""


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories, and the figures."""
    runs = [read_run(path) for path in paths]
    samples = pd.concat([run.samples for run in runs])
    samples = samples.drop_duplicates(["scenario", "method", "sample"])
    whole = replace(runs[0], samples=samples)
    names = ["scenario", "method"]
    rows = [
        {**{name: row[name] for name in names},
         "n": len(recorded_frames(row["scenario"], row["data_hash"])),
         **{end: row[f"below_ceiling_db{of}"]
            for end, of in (("below_db", ""), ("low", "_low"), ("high", "_high"))}}
        for row in leaderboard_rows([whole])
        if row["below_ceiling_db"] is not None
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    table.to_csv(OUT / "below.csv", index=False, float_format="%.6g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")
    curves = noise_curves(whole)
    assert curves is not None
    with mpl.rc_context(STYLE):
        save(draw(curves), DOCS / "ceiling", ("png",))
        save(widths(frames()), DOCS / "ceiling-width", ("png",))


def widths(of: pd.DataFrame) -> Figure:
    """Standard deviation of the place over depth, contrast and area of touches, by noise."""
    of = of.assign(
        place_mm=1e3 * np.hypot(of["sd_x"], of["sd_y"]),
        depth_mm=1e3 * np.minimum.reduce([of["true_x"], of["true_y"],
                                          0.1 - of["true_x"], 0.1 - of["true_y"]]),
        contrast=of["true_strength"] / of["true_area"],
        area_cm2=1e4 * of["true_area"],
    )  # fmt: skip
    heads = {
        "depth_mm": "distance of the touch from the rim [mm]",
        "contrast": "mean fall of conductivity, relative",
        "area_cm2": "area of the touch [cm$^2$]",
    }
    figure = new_figure(PAGE, 2.6)
    panels = figure.subplots(1, len(heads), sharey=True)
    levels = sorted(of["snr_db"].unique())
    for axes, (name, head) in zip(panels, heads.items(), strict=True):
        for k, level in enumerate(levels):
            at = of[of["snr_db"] == level]
            by = at.groupby(pd.qcut(at[name], GROUPS, labels=False))
            axes.plot(
                by[name].median(), by["place_mm"].median(), ms=3.5, lw=1.2, label=f"{level:g} dB",
                **line_style(k),
            )  # fmt: skip
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xlabel(head)
        axes.grid(alpha=0.25, lw=0.5)
    panels[0].set_ylabel("posterior width of the place [mm]")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False
    )
    return figure


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
