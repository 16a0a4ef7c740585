"""The transfer question as one table and one figure: the error over labelled presses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from eitbench.benchmark.analysis.transfer import over_skins, skin_errors
from eitbench.reports.figures.finding import Finding
from eitbench.reports.figures.style import NOTE, PAGE, label_axes, line_style, new_figure
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run

LEGEND = (
    "Median over skins of the median distance between a press and its place, in brackets the 95 % "
    "interval over skins. Without labelled presses, places are registered by a similarity."
)


def findings(runs: Sequence[Run]) -> list[Finding]:
    """Return the errors of all `runs` over labelled presses; none without scenarios of transfer."""
    errors = skin_errors(runs)
    if not errors:
        return []
    curves = over_skins(errors)
    shows = (
        "Error of the place over the number of labelled presses of the skin; the table below has "
        "all figures"
    )
    table, figure = pd.DataFrame(errors), draw(curves)
    return [Finding("transfer", "A new skin", table, grid(curves), LEGEND, figure, shows)]


def grid(curves: pd.DataFrame) -> list[list[str]]:
    """The table as texts, its heads first; the best method of each number first."""
    counts = sorted(curves["labelled"].unique())
    known = {(row["method"], row["labelled"]): row for row in curves.to_dict("records")}
    methods = list(dict.fromkeys(curves["method"]))
    heads = [f"{count} labelled [mm]" for count in counts]
    return [
        ["method", *heads],
        *(
            [printable(method), *(_cell(known.get((method, count))) for count in counts)]
            for method in methods
        ),
    ]


def _cell(row: Mapping[Hashable, Any] | None) -> str:
    if row is None:
        return "–"
    ends = "" if pd.isna(row["low_mm"]) else f" ({row['low_mm']:.1f} to {row['high_mm']:.1f})"
    return f"{row['median_mm']:.1f}{ends}"


def draw(curves: pd.DataFrame) -> Figure:
    """The error of each method over the number of labelled presses, both on log axes."""
    figure = new_figure(PAGE, 4.2)
    axes = figure.subplots()
    counts = sorted(curves["labelled"].unique())
    # 0 has no place on a logarithmic axis: it stands before the others.
    place = {count: count or min((c for c in counts if c), default=10) / 3 for count in counts}
    methods = list(dict.fromkeys(curves["method"]))
    for k, method in enumerate(methods):
        of = curves[curves["method"] == method].sort_values("labelled")
        beside = 1.03 ** (k - (len(methods) - 1) / 2)
        x = of["labelled"].map(place).to_numpy(dtype=float) * beside
        middle = of["median_mm"].to_numpy()
        style = line_style(k)
        axes.plot(x, middle, label=printable(method), **style)
        axes.vlines(x, of["low_mm"], of["high_mm"], color=style["color"], lw=0.8, alpha=0.5)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([place[c] for c in counts], list(map(str, counts)))
    least, most = curves["median_mm"].min() / 2, 1.3 * curves["median_mm"].max()
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50) if least < tick < most]
    axes.set_yticks(ticks, list(map(str, ticks)))
    axes.minorticks_off()
    label_axes(axes, "", "labelled presses of the skin", "error of the place [mm]")
    axes.legend(fontsize=NOTE, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
    return figure
