"""Quality against noise as one table and one figure, the ceiling above and nothing below."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from eitbench.benchmark.findings.noise import CEILING, UNTOUCHED, NoiseCurves, noise_curves
from eitbench.reports.figures.style import COLUMN, NOTE, PAGE, line_style, new_figure, plain_label
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run

_FIRST = 6
"""Methods with a line in colour, the best ones at the middle level; others are grey."""

_MEANS = {
    CEILING: "The ceiling is the posterior mean by a sampler that is told the law of the phantoms, "
    "the noise and the sensor as built: what frames allow is at least this.",
    UNTOUCHED: "The untouched sensor is an image without a touch.",
}


def findings(run: Run) -> list[Finding]:
    """Return quality against noise of a run; none of runs without several levels of noise."""
    curves = noise_curves(run)
    if curves is None:
        return []
    table = curves.psnr.set_axis(_levels(curves), axis=1).rename_axis("method").reset_index()
    grid = [["PSNR of the mean error [dB]", *_levels(curves)]] + [
        [printable(str(name)), *("–" if math.isnan(v) else f"{v:.1f}" for v in row)]
        for name, row in curves.psnr.iterrows()
    ]
    legend = f"PSNR of the mean squared error over {curves.n} phantoms, the same at all levels."
    for name, means in _MEANS.items():
        legend += f" {means}" if name in curves.psnr.index else ""
    shows = "A line for each row of the table"
    wide, narrow = (draw(curves, width) for width in (PAGE, COLUMN))
    return [Finding("noise", "Quality against noise", table, grid, legend, wide, shows, narrow)]


def _levels(curves: NoiseCurves) -> list[str]:
    levels = curves.psnr.columns.to_numpy(np.float64)
    return ["clean" if math.isinf(level) else f"{level:g} dB" for level in levels]


def draw(curves: NoiseCurves, width: float = PAGE) -> Figure:
    """The curves over the level of noise, clean frames last."""
    figure = new_figure(width, 3.2)
    axes: Axes = figure.subplots()
    at = range(len(curves.psnr.columns))
    middle = curves.psnr.columns[len(curves.psnr.columns) // 2]
    methods = curves.psnr.drop(index=[CEILING, UNTOUCHED], errors="ignore")
    methods = methods.sort_values(middle, ascending=False)
    for k, (name, row) in enumerate(methods.iterrows()):
        if k < _FIRST:
            axes.plot(at, row, ms=3.5, lw=1.3, label=plain_label(str(name)), **line_style(k))
        else:
            label = "other methods" if k == _FIRST else None
            axes.plot(at, row, lw=0.8, color="0.75", zorder=1, label=label)
    low, high = axes.get_ylim()
    if CEILING in curves.psnr.index:
        ceiling = curves.psnr.loc[CEILING].to_numpy(np.float64)
        high = max(high, np.nanmax(ceiling) + 1)
        axes.plot(at, ceiling, color="black", lw=1.6, label="ceiling")
    if UNTOUCHED in curves.psnr.index:
        nothing = curves.psnr.loc[UNTOUCHED].to_numpy(np.float64)
        low = min(low, np.nanmin(nothing) - 1)
        axes.plot(at, nothing, color="0.4", lw=1, ls=":", label="untouched sensor")
    axes.set_ylim(low, high)
    axes.set_xlim(-0.1, len(at) - 0.9)
    axes.set_xticks(list(at), _levels(curves))
    axes.set_xlabel("SNR of a frame")
    axes.set_ylabel("PSNR of the mean error [dB]")
    axes.grid(alpha=0.25, lw=0.5)
    beside = width > COLUMN
    figure.legend(
        loc="outside right center" if beside else "outside lower center",
        ncols=1 if beside else 2, fontsize=NOTE, frameon=False,
    )  # fmt: skip
    return figure
