"""When not to trust an image: table and figure of how well scores tell conditions not known."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.novelty import Told, read_novelty
from eitbench.benchmark.metrics.novelty import FALSE_ALARMS, NOVELTY, SCORES
from eitbench.reports.figures.style import COLOURS, NOTE, PAGE, marker, new_figure, plain_label
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run

_LEGEND = (
    "AUROC of scores of frames: how often a frame of a condition that methods do not know has a "
    "greater score than one that they know; 0.5 is a coin, 1 tells all apart, and less than 0.5 "
    "takes what is novel for the more familiar. Frame: by the frame and its reference alone. "
    "Residuals are those of the exact model at the method's image, the baseline; uncertainty and "
    "novelty are what the method states. Mean: of "
    "the conditions for which all rows have a value; rows are sorted by it. The table in the file "
    f"has intervals, the share of novel frames caught at {FALSE_ALARMS:.0%} of false alarms, and "
    "how well scores order images by their errors."
)
_SHOWS = "A panel for each condition, a row for each method, a marker for each score"
_COLUMNS = 3


def findings(run: Run) -> list[Finding]:
    """Return the table and figure of a run; none where no condition is judged."""
    found = read_novelty(run)
    if not found:
        return []
    title = "When not to trust an image"
    return [Finding("novelty", title, to_table(found), grid(found), _LEGEND, draw(found), _SHOWS)]


def to_table(found: list[Told]) -> pd.DataFrame:
    """All figures: a row for each condition, method and score."""
    rows = []
    for one in found:
        row: dict[str, object] = {
            "scenario": one.scenario, "familiar": one.familiar, "method": one.method,
            "score": one.score, "n": one.n, "failed": one.failed,
        }  # fmt: skip
        for name, (value, low, high) in one.figures.items():
            row |= {name: value, f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def by_condition(table: pd.DataFrame, figure: str = "auroc") -> pd.DataFrame:
    """A figure by method and score (rows) and condition, with their `mean`, the best row first.

    Args:
        table: of `to_table`.
        figure: a name of `NOVELTY`.
    """
    order = table["scenario"].unique()
    keys = ["method", "score"]
    wide = table.pivot_table(figure, keys, "scenario", sort=False, dropna=False)[order]
    wide = wide.dropna(how="all")
    wide["mean"] = wide[wide.columns[wide.notna().all()]].mean(axis=1)
    return wide.sort_values("mean", ascending=False, kind="stable")


def grid(found: list[Told]) -> list[list[str]]:
    """The printed table, its heads first."""
    wide, form = by_condition(to_table(found)), NOVELTY["auroc"].form
    heads = ["Method", "Score", *map(printable, wide.columns[:-1]), "Mean"]
    rows = [
        [printable(method), SCORES[score].title,
         *("–" if math.isnan(value) else format(value, form) for value in values)]
        for (method, score), values in zip(wide.index, wide.to_numpy(), strict=True)
    ]  # fmt: skip
    return [heads, *rows]


def draw(found: list[Told]) -> Figure:
    """A panel for each condition: AUROC with interval by method, a marker for each score."""
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    best = by_condition(to_table(found))["mean"].groupby("method").max().sort_values()
    methods = best.index.tolist()
    scores = [name for name in SCORES if any(one.score == name for one in found)]
    rows = math.ceil(len(scenarios) / _COLUMNS)
    figure = new_figure(PAGE, rows * (0.7 + 0.19 * len(methods)) + 0.4)
    panels = figure.subplots(rows, min(_COLUMNS, len(scenarios)), sharey=True, squeeze=False)
    for axes, scenario in zip(panels.flat, scenarios, strict=False):
        axes.axvline(0.5, color="0.5", lw=1, ls=":", zorder=1)
        for k, name in enumerate(scores):
            of = [one for one in found if (one.scenario, one.score) == (scenario, name)]
            x = np.array([one.figures["auroc"] for one in of]).reshape(-1, 3)
            y = np.array([methods.index(one.method) for one in of]) + 0.15 * (
                k - (len(scores) - 1) / 2
            )
            axes.hlines(y, x[:, 1], x[:, 2], color=COLOURS[k], lw=0.8, zorder=2)
            axes.plot(
                x[:, 0], y, ls="", marker=marker(k), ms=3.2, color=COLOURS[k],
                label=SCORES[name].title, zorder=3,
            )  # fmt: skip
        axes.set_title(plain_label(scenario), loc="left")
        axes.set_xlim(-0.02, 1.02)
        axes.set_yticks(range(len(methods)), [plain_label(method) for method in methods])
        axes.set_xlabel("AUROC")
        axes.grid(alpha=0.25, lw=0.5)
    for axes in panels.flat[len(scenarios) :]:
        axes.set_axis_off()
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=len(scores), fontsize=NOTE, frameon=False
    )
    return figure
