"""The track of stated uncertainty: its table, and diagrams of how far it can be relied on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.noise import CEILING
from eitbench.benchmark.findings.uncertainty import Stated, read_uncertainty
from eitbench.benchmark.metrics.uncertainty import LEVELS, REMOVED, UNCERTAINTY
from eitbench.reports.figures.style import NOTE, PAGE, line_style, new_figure, plain_label
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
    "better; those that have fewer frames than others have no rank. Methods that share a letter "
    "cannot be told apart, in paired differences on the same frames. In parentheses: 95 % "
    "intervals over sessions. In 50, 80, 95 %: share of pixels whose truth lies within the central "
    "interval of that level, of those where truth and draws differ. Error / spread: of the draws' "
    "mean; 1 is right. AUSE: 0 where the stated deviation ranks pixels as their errors do. Place "
    "in 95 %: share of true places among the 95 % nearest to the middle of the places drawn, and "
    "the median radius of that region."
)
_SHOWS = {
    "pixels": "the share of true values of pixels in central intervals against their level",
    "left": "the error left when the least sure pixels are left out",
    "places": "the share of true places in regions about the middle of those drawn, against their "
    "level",
}
_AXES = {
    "pixels": ("Central intervals [%]", "True values in them [%]"),
    "left": ("Least sure pixels left out [%]", "Error left"),
    "places": ("Middle regions [%]", "True places in them [%]"),
}
_HOW = (
    "In the figure, statements are right on dotted lines. Bars: 95 % intervals over sessions, at "
    "three levels; places are at these levels alone."
)


def findings(run: Run) -> list[Finding]:
    """Return the track of a run; none where no method states its uncertainty."""
    found = read_uncertainty(run)
    if not found:
        return []
    grid = [_heads(found), *(_cells(one, found) for one in found)]
    panels = _panels(found)
    wide = draw(found) if panels else None
    shows = ", then ".join(_SHOWS[kind] for kind in panels)
    if len(panels) > 1:
        shows = f"From the left: {shows}"
    legend = f"{_LEGEND} {_HOW}" if panels else _LEGEND
    return [Finding("uncertainty", "Uncertainty", to_table(found), grid, legend, wide, shows)]


def to_table(found: list[Stated]) -> pd.DataFrame:
    """All figures: a row for each scenario and method."""
    rows = []
    for one in found:
        row: dict[str, object] = {
            "scenario": one.scenario, "rank": one.rank, "method": one.method, "group": one.group,
            "n": one.n,
        }  # fmt: skip
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
    first = first_columns(found[0], found, "")
    return [*first, *(UNCERTAINTY[name].heading for name in _shown(found))]


def _cells(one: Stated, found: list[Stated]) -> list[str]:
    first = first_columns(one, found, one.method)
    return [*map(printable, first.values()), *(figure_text(one, name) for name in _shown(found))]


def first_columns(one: Stated, found: list[Stated], method: str) -> dict[str, str]:
    """What stands before the figures of a row by heading; no rank where nothing is ranked."""
    columns = {
        "Scenario": one.scenario, "#": str(one.rank or "–"), "Method": method,
        "Ties": one.group or "–", "n": str(one.n),
    }  # fmt: skip
    if all(other.rank is None for other in found):
        del columns["#"], columns["Ties"]
    return columns


def figure_text(one: Stated, name: str) -> str:
    """A figure as tables print it, some of them with their 95 % interval."""
    interval, form = one.figures[name], UNCERTAINTY[name].form
    if math.isnan(interval.value):
        return "–"
    text = format(interval.value, form)
    if name in _WITH_INTERVAL and not math.isnan(interval.low):
        text += f" ({interval.low:{form}} to {interval.high:{form}})"
    return text


def _panels(found: list[Stated]) -> list[str]:
    """The kinds of panels, of `_SHOWS`, that there is something to draw in, in their order."""
    places = any(not math.isnan(one.figures["place_coverage_50"].value) for one in found)
    curves = any(one.curves is not None for one in found)
    return ["pixels", "left"] * curves + ["places"] * places


def draw(found: list[Stated]) -> Figure:
    """Reliability of pixels, sparsification and reliability of places.

    Scenarios have a row each; where there is one kind of panel alone, they stand side by side.
    """
    scenarios = list(dict.fromkeys(one.scenario for one in found))
    if len(scenarios) > _MOST:
        at = np.linspace(0, len(scenarios) - 1, _MOST).round().astype(int)
        scenarios = [scenarios[k] for k in at]
    # Methods keep their colours whether there is a ceiling beside them or not.
    methods = dict.fromkeys(one.method for one in found if one.method != CEILING)
    styles = {name: line_style(k) for k, name in enumerate(methods)}
    styles[CEILING] = {"marker": "D", "color": "black", "ls": "-"}
    panels = _panels(found)
    shape = (len(scenarios), len(panels)) if len(panels) > 1 else (1, len(scenarios))
    figure = new_figure(PAGE, 0.5 + 1.95 * shape[0])
    grid = figure.subplots(*shape, squeeze=False).reshape(len(scenarios), len(panels))
    for row, scenario in zip(grid, scenarios, strict=True):
        here = [one for one in found if one.scenario == scenario]
        for kind, axes in zip(panels, row, strict=True):
            for one in here:
                _draw_one(axes, kind, one, styles[one.method] | {"ms": 3, "lw": 1.2})
            axes.set_visible(bool(axes.lines))
            x, y = _AXES[kind]
            axes.set(xlabel=x, ylabel=y)
            axes.grid(alpha=0.25, lw=0.5)
            if kind == "left":
                axes.set_ylim(bottom=0)
            else:
                axes.plot([0, 100], [0, 100], color="0.5", lw=1, ls=":", zorder=1)
        first = next((axes for axes in row if axes.get_visible()), row[0])
        first.set_title(plain_label(scenario), loc="left")
    handles = {
        text: handle
        for axes in grid.flat
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside lower center",
        ncols=4, fontsize=NOTE, frameon=False,
    )  # fmt: skip
    return figure


def _draw_one(axes: Axes, kind: str, one: Stated, style: dict[str, Any]) -> None:
    """One method in a panel of a kind of `_SHOWS`; nothing where it has nothing to show there."""
    if kind == "left":
        by_deviation = np.array(one.curves.sparsified[0]) if one.curves else np.zeros(1)
        if by_deviation[0] > 0:
            axes.plot(100 * REMOVED, by_deviation / by_deviation[0], markevery=4, **style)
        return
    prefix = "coverage_" if kind == "pixels" else "place_coverage_"
    at_levels = [one.figures[f"{prefix}{level}"] for level in LEVELS]
    if math.isnan(at_levels[0].value):
        return
    if kind == "pixels" and one.curves is not None:
        x, y = one.curves.reliability()
        style |= {"markevery": 4}
    else:
        x, y = np.array(LEVELS) / 100, np.array([interval.value for interval in at_levels])
    axes.plot(100 * x, 100 * y, label=plain_label(one.method), **style)
    for level, (_, low, high) in zip(LEVELS, at_levels, strict=True):
        axes.vlines(level, 100 * low, 100 * high, color=style["color"], lw=0.8)
