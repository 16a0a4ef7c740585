"""The transfer question as one table and one figure: the error over labelled presses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from eitbench.benchmark.findings.transfer import over_skins, skin_errors
from eitbench.reports.figures.style import (
    COLOURS,
    COLUMN,
    HEADING,
    NOTE,
    PAGE,
    new_figure,
    plain_label,
)
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run

LEGEND = (
    "Median over skins of the median distance between a press and its place, in brackets the 95 % "
    "interval over skins. Without labelled presses, places are registered by a similarity. Methods "
    "that share a letter in a column cannot be told apart (signed-rank test of the skins' median "
    "errors, Holm's correction for all pairs of the column)."
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
    table, figure, narrow = pd.DataFrame(errors), draw(curves), draw(curves, COLUMN)
    return [Finding("transfer", "A new skin", table, grid(curves), LEGEND, figure, shows, narrow)]


def grid(curves: pd.DataFrame) -> list[list[str]]:
    """The table as texts, its heads first; the best method of each number first."""
    counts, most = sorted(curves["labelled"].unique()), curves["skins"].max()
    known = {(row["method"], row["labelled"]): row for row in curves.to_dict("records")}
    methods = list(dict.fromkeys(curves["method"]))
    heads = [f"{count} labelled [mm]" for count in counts]
    return [
        ["method", *heads],
        *(
            [printable(method), *(_cell(known.get((method, count)), most) for count in counts)]
            for method in methods
        ),
    ]


def _cell(row: Mapping[Hashable, Any] | None, most: int) -> str:
    if row is None:
        return "–"
    ends = "" if pd.isna(row["low_mm"]) else f" ({row['low_mm']:.1f} to {row['high_mm']:.1f})"
    fewer = f", {row['skins']} of {most} skins" if row["skins"] < most else ""
    return f"{row['median_mm']:.1f}{ends} {row['ties']}".rstrip() + fewer


def draw(curves: pd.DataFrame, width: float = PAGE) -> Figure:
    """The error of each method over the number of labelled presses, a panel each, on log axes.

    Bars are 95 % intervals over skins. The other methods are grey behind it, and a dashed line is
    what guessing one place costs. In a column of a paper (`width`), three panels lie side by side.
    """
    methods = list(dict.fromkeys(curves["method"]))
    across = min(5 if width > COLUMN else 3, len(methods))
    down = -(-len(methods) // across)
    figure = new_figure(width, 0.5 + 1.25 * down)
    guess, counts = curves["guess_mm"].median(), sorted(curves["labelled"].unique())
    # 0 has no place on a logarithmic axis: it stands before the others.
    place = {count: count or min((c for c in counts if c), default=10) / 3 for count in counts}
    lines = {
        method: of.sort_values("labelled")
        for method, of in curves.assign(x=curves["labelled"].map(place)).groupby("method")
    }
    panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    for k, axes in enumerate(panels[: len(methods)]):
        for of in lines.values():
            axes.plot(of["x"], of["median_mm"], color="0.85", lw=0.8, marker=".", ms=2, zorder=1)
        of, colour = lines[methods[k]], COLOURS[0]
        axes.vlines(of["x"], of["low_mm"], of["high_mm"], color=colour, lw=1.2, zorder=2)
        axes.plot(of["x"], of["median_mm"], color=colour, lw=1.2, marker="o", ms=3.5, zorder=3)
        axes.axhline(guess, color="black", ls="--", lw=0.7, zorder=1)
        axes.set_title(plain_label(methods[k]), fontsize=NOTE if width > COLUMN else 5.5)
        axes.tick_params(labelsize=NOTE - 1, labelbottom=k + across >= len(methods))
    right, above = max(place.values()), 1.04 * guess
    panels[0].text(right, above, "guessing one place", ha="right", va="bottom", fontsize=NOTE - 1)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks([place[c] for c in counts], list(map(str, counts)))
    least, most = curves["median_mm"].min() / 1.5, 1.7 * max(guess, curves["median_mm"].max())
    axes.set_ylim(least, most)
    ticks = [tick for tick in (1, 2, 5, 10, 20, 50) if least < tick < most]
    axes.set_yticks(ticks, list(map(str, ticks)))
    for axes in panels:
        axes.minorticks_off()
    for axes in panels[len(methods) :]:
        axes.set_visible(False)
    figure.supxlabel("labelled presses of the skin", fontsize=HEADING)
    figure.supylabel("error of the place [mm]", fontsize=HEADING)
    return figure
