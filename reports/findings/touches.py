"""What becomes of errors over the time of a recording, and when two touches are told apart.

And when methods give an alarm on a skin that is cut.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.drift import LAG_S, PARTS, alarms, over_time
from eitbench.benchmark.findings.two_touch import WITHIN_MM, least_distance, told_apart
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.figures.style import PAGE, line_style, new_figure, plain_label
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run

_NONE = "–"
_FIFTHS = {1: "first fifth", (PARTS + 1) // 2: "middle fifth", PARTS: "last fifth"}


def findings(run: Run) -> list[Finding]:
    """What the stored figures of a run say of time, two touches and cuts; none of other runs."""
    if run.kind != METHOD_RUNS:
        return []
    return [*_of_time(run), *_of_two_touches(run), *_of_alarms(run)]


def _of_time(run: Run) -> list[Finding]:
    table = over_time(run)
    if table.empty:
        return []
    x_label = "fifth of the presses, in order of time"
    figure = panels(table, "part", "error_mm", x_label, "error [mm]")
    legend = (
        "Median error of the place [mm] with its 95 % interval over presses; the order of presses "
        "is time."
    )
    grid = time_grid(table)
    return [Finding("over-time", "Error over time", table, grid, legend, figure)]


def _of_two_touches(run: Run) -> list[Finding]:
    table = told_apart(run.samples)
    if table.empty:
        return []
    x_label = "distance of the two touches [mm]"
    pairs = table[table["apart"].notna()]
    figure = panels(pairs, "distance_mm", "apart", x_label, "share told apart", highest=1.02)
    legend = (
        "Told apart: the two strongest contacts of the image are each nearer to its own touch than "
        f"half the distance of both, and than {WITHIN_MM:.0f} mm. Half from: smallest distance "
        "from which on at least half are told apart. Counted: share of touches that are shown as "
        "as many contacts as they have, of two touches and of single ones."
    )
    grid = apart_grid(table)
    return [Finding("two-touch", "Two touches at once", table, grid, legend, figure)]


def _of_alarms(run: Run) -> list[Finding]:
    table = alarms(run)
    legend = (
        "False alarms: share of frames before any cut that give one, of the change against the "
        f"start and against the frame {LAG_S:.0f} s before. Delay: from the first frame of a cut "
        "to the alarm of the latter. Lasting: size of what the cut has changed for good, over what "
        "drift changes in as long a time (99th percentile). Place: distance of the centre of the "
        "change in the image, while cut and for good, from the cut; images are not registered."
    )
    return [] if table.empty else [Finding("alarms", "Alarms", table, alarm_grid(table), legend)]


def time_grid(table: pd.DataFrame) -> list[list[str]]:
    """Return the error in the first, middle and last fifth as texts, from `over_time`."""
    rows = [["data", "method", *(f"{name} [mm]" for name in _FIFTHS.values())]]
    for (scenario, method), cell in table.groupby(["scenario", "method"], sort=False):
        parts = cell.set_index("part")
        rows.append(
            [
                printable(str(scenario)),
                printable(str(method)),
                *(
                    f"{parts['error_mm'][k]:.1f} ({parts['low'][k]:.1f} to {parts['high'][k]:.1f})"
                    for k in _FIFTHS
                ),
            ]
        )
    return rows


def apart_grid(table: pd.DataFrame) -> list[list[str]]:
    """Return the shares told apart at each distance as texts, from `told_apart`."""
    distances = sorted(d for d in table["distance_mm"].unique() if d > 0)
    rows = [["data", "method", *(f"{d:g} mm" for d in distances), "half from", "counted, two"]]
    rows[0].append("counted, one")
    for (scenario, method), cell in table.groupby(["scenario", "method"], sort=False):
        apart, counted = (cell.set_index("distance_mm")[name] for name in ("apart", "counted"))
        least = least_distance(apart)
        rows.append(
            [
                printable(str(scenario)),
                printable(str(method)),
                *(_share(apart.get(d, np.nan)) for d in distances),
                "never" if np.isnan(least) else f"{least:g} mm",
                _share(cell["counted"][cell["distance_mm"] > 0].mean()),
                _share(counted.get(0.0, np.nan)),
            ]
        )
    return rows


def _share(value: float) -> str:
    return _NONE if np.isnan(value) else f"{value:.0%}"


def alarm_grid(table: pd.DataFrame) -> list[list[str]]:
    """Return false alarms, and delay, size and places of each cut, as texts, from `alarms`."""
    cuts = list(table["cut"].unique())
    rows = [
        [
            "detector", "false, start", f"false, {LAG_S:.0f} s",
            *(f"{cut}: {what}" for cut in cuts for what in ("delay", "lasting", "place [mm]")),
        ]
    ]  # fmt: skip
    for method, cell in table.groupby("method", sort=False):
        of = cell.set_index("cut")
        shares = (f"{cell[name].iloc[0]:.0%}" for name in ("false_start", "false_before"))
        cells = (text for cut in cuts for text in _of_cut(of.loc[cut]))
        rows.append([printable(str(method)), *shares, *cells])
    return rows


def _of_cut(of: pd.Series) -> list[str]:
    known = not np.isnan(of["place_mm"])
    return [
        "none" if np.isnan(of["delay_s"]) else f"{of['delay_s']:.0f} s",
        f"{of['lasting']:.1f}",
        f"{of['during_mm']:.0f}, {of['place_mm']:.0f}" if known else _NONE,
    ]


def panels(
    table: pd.DataFrame, x: str, y: str, x_label: str, y_label: str, highest: float | None = None
) -> Figure:
    """A panel for each scenario with a line for each method, and its intervals."""
    scenarios = list(table["scenario"].unique())
    columns = min(len(scenarios), 2 if len(scenarios) <= 4 else 4)
    lines = -(-len(scenarios) // columns)
    figure = new_figure(PAGE, 0.5 + 2.3 * lines)
    panels = figure.subplots(lines, columns, squeeze=False, sharey=True).ravel()
    methods = list(table["method"].unique())
    values = np.sort(table[x].unique())
    span = values[-1] - values[0]
    beside = 0.01 * span
    for panel, scenario in zip(panels, scenarios, strict=False):
        of = table[table["scenario"] == scenario]
        for k, method in enumerate(methods):
            _line(panel, of[of["method"] == method], x, y, k, (k - len(methods) / 2) * beside)
        panel.set_title(plain_label(scenario), loc="left")
        panel.set_xlabel(x_label)
        panel.set_xlim(values[0] - 0.06 * span, values[-1] + 0.06 * span)
        panel.set_xticks(values, [f"{value:g}" for value in values])
        panel.grid(alpha=0.3, lw=0.4)
    panels[0].set_ylim(0, highest)  # of all
    for panel in panels[::columns]:
        panel.set_ylabel(y_label)
    for panel in panels[len(scenarios) :]:
        panel.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    return figure


def _line(axes: Axes, cell: pd.DataFrame, x: str, y: str, k: int, shift: float) -> None:
    """One method, a little beside the others, so that their intervals do not hide each other."""
    if cell.empty:
        return
    low, high = cell[y] - cell["low"], cell["high"] - cell[y]
    axes.errorbar(
        cell[x] + shift, cell[y], yerr=np.maximum([low, high], 0.0), **line_style(k), ms=3, lw=1,
        elinewidth=0.5, label=plain_label(str(cell["method"].iloc[0])),
    )  # fmt: skip
