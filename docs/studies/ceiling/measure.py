"""How far methods are below the ceiling, and what its posterior says of the sensor.

`python -m docs.studies.ceiling.measure RUN...` reads the record of the ceiling and a run of the
suite `noise` and runs of others, writes the distance of every method in every scenario to
`below.csv`, commands and versions of the runs to `runs.json`, and draws `docs/ceiling.png`; with
or without runs, it draws the figures of the record itself: `docs/ceiling-reliability.png`,
`docs/ceiling-width.png` and `docs/ceiling-map.png`.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from docs.tables.ceiling import frames
from docs.tables.record import DOCS, STUDIES, about_runs
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy import stats

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.ceiling.agreement import TRACES
from eitbench.benchmark.ceiling.record import recorded_frames
from eitbench.benchmark.findings.noise import noise_curves
from eitbench.reports.figures.style import PAGE, STYLE, line_style, new_figure, save
from eitbench.reports.findings.noise import draw
from eitbench.scenarios.sensors.sensor import foam16

OUT = STUDIES / "ceiling"
_TRACES = {"x": "place, x", "y": "place, y", "strength": "strength", "area": "area"}
GROUPS = 3
"""Equal groups of frames that a curve has a point for."""


def write(paths: Sequence[Path]) -> None:
    """Write the record of run directories, if any, and the figures."""
    with mpl.rc_context(STYLE):
        save(reliability(frames()), DOCS / "ceiling-reliability", ("png",))
        save(widths(frames()), DOCS / "ceiling-width", ("png",))
        save(width_maps(frames()), DOCS / "ceiling-map", ("png",))
    if not paths:
        return
    runs = [read_run(path) for path in paths]
    names = ["scenario", "method"]
    rows = [
        {**{name: row[name] for name in names},
         "frames": min(row["n"], len(recorded_frames(row["scenario"], row["data_hash"]))),
         **{end: row[f"below_ceiling_db{of}"]
            for end, of in (("below_db", ""), ("low", "_low"), ("high", "_high"))}}
        for run in runs
        for row in leaderboard_rows([run])
        if row["below_ceiling_db"] is not None
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    table.to_csv(OUT / "below.csv", index=False, float_format="%.6g", lineterminator="\n")
    (OUT / "runs.json").write_text(json.dumps(about_runs(runs), indent=1) + "\n")
    for curves in filter(None, map(noise_curves, runs)):
        with mpl.rc_context(STYLE):
            save(draw(curves), DOCS / "ceiling", ("png",))


def reliability(of: pd.DataFrame) -> Figure:
    """Share of true traces in central intervals of the draws, a panel for each SNR.

    The band holds 95 % of what chance gives right draws of so many frames (binomial).
    """
    levels = np.linspace(0.0, 1.0, 101)
    figure = new_figure(PAGE, 2.6)
    panels = figure.subplots(1, of["snr_db"].nunique(), sharey=True)
    for axes, (snr_db, at) in zip(panels, of.groupby("snr_db"), strict=True):
        ends = stats.binom.interval(0.95, len(at), levels)
        axes.fill_between(100 * levels, *(100 * end / len(at) for end in ends), color="0.9")
        axes.plot([0, 100], [0, 100], color="0.5", lw=1, ls=":")
        for k, name in enumerate(TRACES):
            off = np.sort(2 * np.abs(at[f"rank_{name}"] - 0.5))
            held = np.searchsorted(off, levels, side="right") / len(at)
            style = line_style(k) | {"marker": ""}
            axes.plot(100 * levels, 100 * held, lw=1.2, label=_TRACES[name], **style)
        axes.set_title(f"{snr_db:g} dB, {len(at)} frames", loc="left")
        axes.set(xlabel="central interval [%]", xlim=(-4, 108))
        axes.grid(alpha=0.25, lw=0.5)
    panels[0].set_ylabel("truths in it [%]")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False
    )
    return figure


def widths(of: pd.DataFrame) -> Figure:
    """Standard deviation of the place over depth, contrast and area of touches, by noise."""
    x0, y0, x1, y1 = foam16().outline.bounds
    of = of.assign(
        place_mm=1e3 * np.hypot(of["sd_x"], of["sd_y"]),
        depth_mm=1e3 * np.minimum.reduce([of["true_x"] - x0, of["true_y"] - y0,
                                          x1 - of["true_x"], y1 - of["true_y"]]),
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


def width_maps(of: pd.DataFrame) -> Figure:
    """Width of the place, and of the strength, at the places of touches, a column for each SNR."""
    foam = foam16()
    x0, y0, x1, y1 = (1e3 * end for end in foam.outline.bounds)
    shown = {
        "place [mm]": 1e3 * np.hypot(of["sd_x"], of["sd_y"]),
        "strength [%]": 100 * of["sd_strength"] / of["true_strength"].abs(),
    }
    levels = sorted(of["snr_db"].unique(), reverse=True)
    figure = new_figure(PAGE, 1.3 + 10.8 / len(levels))
    panels = figure.subplots(len(shown), len(levels), sharex=True, sharey=True)
    electrodes = 1e3 * np.array([foam.outline.point(e.centre) for e in foam.electrodes])
    for row, (name, width) in zip(panels, shown.items(), strict=True):
        scale = LogNorm(width.quantile(0.02), width.quantile(0.98))
        for axes, level in zip(row, levels, strict=True):
            at = of["snr_db"] == level
            points = axes.scatter(
                1e3 * of["true_x"][at], 1e3 * of["true_y"][at], c=width[at], norm=scale,
                s=16, cmap="viridis_r", edgecolors="0.3", linewidths=0.3,
            )  # fmt: skip
            axes.plot(*electrodes.T, "s", color="0.25", ms=3.5, clip_on=False)
            axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
            axes.set_title(f"{level:g} dB", loc="left")
        figure.colorbar(points, ax=row, label=f"width of the {name}", format="{x:g}", shrink=0.9)
        row[0].set_ylabel("y [mm]")
    for axes in panels[-1]:
        axes.set_xlabel("x [mm]")
    return figure


if __name__ == "__main__":
    write([Path(run) for run in sys.argv[1:]])
