"""The track of stated uncertainty: its table, with diagrams of reliability and sparsification."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.uncertainty import Stated, read_uncertainty
from eitbench.benchmark.metrics.uncertainty import LEVELS, REMOVED, UNCERTAINTY
from eitbench.reports.figures.style import COLUMN, NOTE, PAGE, line_style, new_figure, plain_label
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run

_MOST = 4
"""Scenarios in a figure, the first and the last among them; the table has all."""

_WITH_INTERVAL = ("crps", "coverage_95", "place_coverage_95")
_LEGEND = (
    "Methods that state how sure they are, ranked by CRPS [S/m], a proper score: the lower, the "
    "better. In parentheses: 95 % intervals over sessions. In 50, 80, 95 %: share of pixels whose "
    "truth lies within the central interval of that level, among pixels where truth and draws "
    "differ. Error / spread: of the draws' mean; 1 is right. AUSE: 0 where the stated deviation "
    "ranks pixels as their errors do. Place in 95 %: share of true places among the 95 % nearest "
    "to the middle of the places drawn, and the median radius of that region."
)
_SHOWS = (
    "Above, the share of truths in central intervals against their level, where the diagonal is "
    "right, with 95 % interval over sessions at three levels; below, the error left when the least "
    "sure pixels are left out"
)


def findings(run: Run) -> list[Finding]:
    """Return the track of a run; none where no method states its uncertainty."""
    found = read_uncertainty(run)
    if not found:
        return []
    grid = [_heads(found), *(_cells(one, found) for one in found)]
    drawn = [one for one in found if one.curves is not None]
    wide = draw(drawn) if drawn else None
    title = "Uncertainty"
    return [Finding("uncertainty", title, to_table(found), grid, _LEGEND, wide, _SHOWS)]


def to_table(found: list[Stated]) -> pd.DataFrame:
    """All figures: a row for each scenario and method."""
    rows = []
    for one in found:
        row: dict[str, object] = {"scenario": one.scenario, "method": one.method, "n": one.n}
        for name, interval in one.figures.items():
            row[name] = interval.value
            if not math.isnan(interval.low):
                row |= {f"{name}_low": interval.low, f"{name}_high": interval.high}
        rows.append(row)
    return pd.DataFrame(rows)


def _shown(found: list[Stated]) -> list[str]:
    return [
        name for name in UNCERTAINTY
        if any(not math.isnan(one.figures[name].value) for one in found)
    ]  # fmt: skip


def _heads(found: list[Stated]) -> list[str]:
    return ["Scenario", "Method", "n", *(UNCERTAINTY[name].heading for name in _shown(found))]


def _cells(one: Stated, found: list[Stated]) -> list[str]:
    cells = [printable(one.scenario), printable(one.method), str(one.n)]
    return cells + [figure_text(one, name) for name in _shown(found)]


def figure_text(one: Stated, name: str) -> str:
    """A figure as tables print it, some of them with their 95 % interval."""
    interval, form = one.figures[name], UNCERTAINTY[name].form
    if math.isnan(interval.value):
        return "–"
    text = format(interval.value, form)
    if name in _WITH_INTERVAL and not math.isnan(interval.low):
        text += f" ({interval.low:{form}} to {interval.high:{form}})"
    return text


def draw(found: list[Stated], width: float = PAGE) -> Figure:
    """Reliability above and sparsification below, a column for each scenario."""
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    if len(scenarios) > _MOST:
        at = np.linspace(0, len(scenarios) - 1, _MOST).round().astype(int)
        scenarios = [scenarios[k] for k in at]
    styles = {name: k for k, name in enumerate(dict.fromkeys(one.method for one in found))}
    figure = new_figure(width, 4.4)
    grid = figure.subplots(2, len(scenarios), sharey="row", squeeze=False)
    for column, scenario in enumerate(scenarios):
        above, below = grid[:, column]
        above.plot([0, 100], [0, 100], color="0.5", lw=1, ls=":", zorder=1)
        for one in found:
            if one.scenario != scenario or one.curves is None:
                continue
            style = line_style(styles[one.method])
            stated, observed = one.curves.reliability()
            style |= {"ms": 3, "lw": 1.2, "markevery": 4}
            above.plot(100 * stated, 100 * observed, label=plain_label(one.method), **style)
            for level in LEVELS:
                _, low, high = one.figures[f"coverage_{level}"]
                above.vlines(level, 100 * low, 100 * high, color=style["color"], lw=0.8)
            by_deviation, _ = np.array(one.curves.sparsified)
            if by_deviation[0] > 0:
                left = by_deviation / by_deviation[0]
                below.plot(100 * REMOVED, left, **style)
        above.set_title(plain_label(scenario), loc="left")
        _label(above, "Central interval [%]", "Truths in it [%]" if not column else "")
        _label(below, "Least sure pixels left out [%]", "Error left" if not column else "")
        below.set_ylim(0, 1.05)
    handles = {
        text: handle
        for axes in grid[0]
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center",
        ncols=4 if width > COLUMN else 2, fontsize=NOTE, frameon=False,
    )  # fmt: skip
    return figure


def _label(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.25, lw=0.5)
