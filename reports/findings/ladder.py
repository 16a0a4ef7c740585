"""The ladder from simulation to reality as one table and one figure."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.ladder import Ladder, read_ladder
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.figures.style import COLOURS, PAGE, line_style, new_figure, plain_label
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eitbench.benchmark.analysis.results import Run
    from eitbench.benchmark.findings.ladder import Real, Step
    from eitbench.benchmark.metrics.statistics import Interval

_NOT_RUN = "–"
_FIRST = 6
"""Methods with a line in colour, the first ones; others are grey."""
AREAS = ((False, "area over severity"), (True, "area, calibrated"))
LEGEND = (
    "Model off: distance of the nominal model from what a touch changes, noise apart, in dB of "
    "that change (median; – where it is the model of the data). "
    "B: mean of SSIM, CC, 1 - RIE and PSNR between fixed ends, 0 to 1; in brackets what "
    "calibration adds, with ! where the 95 % interval over sessions excludes 0. Area: under B "
    "over severity, divided by its span. Real sensors: what ranks them, in brackets the change by "
    "calibration (circles in the figure)."
)


def findings(run: Run) -> list[Finding]:
    """Return the ladder of a run; none of other runs."""
    ladder = read_ladder(run)
    if ladder is None:
        return []
    title = "From simulation to reality"
    shows = (
        "B of every method on every rung, against severity, and on real sensors; the table below "
        "has all figures"
    )
    if ladder.lacking:
        shows += (
            f". Without {', '.join(map(printable, ladder.lacking))}: they lack touches of rungs"
        )
    table = to_table(ladder)
    return [Finding("ladder", title, table, grid(ladder), LEGEND, draw(ladder), shows)]


def to_table(ladder: Ladder) -> pd.DataFrame:
    """All figures of a ladder: a row for each rung, the area and each recorded set, by method."""
    rows: list[dict[str, object]] = []
    for (rung, method), step in ladder.steps.items():
        row = {"rung": rung, "method": method, "figure": "B", **_ends("", step.value)}
        row |= _ends("loss", step.loss) | _ends("gain", step.gain)
        row |= {"calibrated": None if step.gain is None else step.value.value + step.gain.value}
        rows.append(row)
    for (method, calibrated), area in ladder.areas.items():
        name = "area, calibrated" if calibrated else "area"
        rows.append({"rung": name, "method": method, "figure": "B", **_ends("", area)})
    for (rung, method), real in ladder.real.items():
        row = {"rung": rung, "method": method, "figure": real.figure, "value": real.value}
        rows.append(row | {"calibrated": real.calibrated})
    return pd.DataFrame(rows)


def _ends(name: str, interval: Interval | None) -> dict[str, float]:
    if interval is None:
        return {}
    prefix = f"{name}_" if name else ""
    ends = {f"{prefix}low": interval.low, f"{prefix}high": interval.high}
    return {name or "value": interval.value} | ends


def grid(ladder: Ladder) -> list[list[str]]:
    """Return the table of a ladder as texts, its heads first."""
    methods = ladder.methods
    rows = [["rung", "model off [dB]", *map(printable, methods)]]
    for rung in ladder.rungs:
        steps = [ladder.steps.get((rung, method)) for method in methods]
        distance = ladder.distances.get(rung)
        off = _NOT_RUN if distance is None else f"{distance:.0f}"
        rows.append([label(ladder, rung), off, *map(_step, steps)])
    for title, areas in _areas(ladder).items():
        rows.append([title, "", *(_NOT_RUN if np.isnan(area) else f"{area:.3f}" for area in areas)])
    for rung in dict.fromkeys(rung for rung, _ in ladder.real):
        found = [ladder.real.get((rung, method)) for method in methods]
        rows.append([_titled(ladder, rung), "", *map(_real, found)])
    return rows


def _areas(ladder: Ladder) -> dict[str, list[float]]:
    """The areas of all methods, NaN where there is none, by the names of those that are known."""
    areas = {
        title: [ladder.areas.get((method, calibrated)) for method in ladder.methods]
        for calibrated, title in AREAS
    }
    return {
        title: [math.nan if area is None else area.value for area in known]
        for title, known in areas.items()
        if any(known)
    }


def _step(step: Step | None) -> str:
    if step is None:
        return _NOT_RUN
    if step.gain is None:
        return f"{step.value.value:.3f}"
    gain = f"{step.gain.value:+.3f}"
    if float(gain) == 0:  # however sure, it matters to nobody
        return f"{step.value.value:.3f} (0)"
    sure = "!" if step.gain.low > 0 or step.gain.high < 0 else ""
    return f"{step.value.value:.3f} ({gain}{sure})"


def _real(real: Real | None) -> str:
    if real is None or real.value is None:
        return _NOT_RUN
    if real.calibrated is None:
        return f"{real.value:.3g}"
    change = real.calibrated - real.value
    return f"{real.value:.3g} ({f'{change:+.2g}' if change else '0'})"


def _titled(ladder: Ladder, rung: str) -> str:
    """The name of a recorded set, with the figure that ranks it and its unit."""
    figure = next(real.figure for (name, _), real in ladder.real.items() if name == rung)
    return printable(f"{rung}: {METHOD_RUNS.metrics[figure].heading}")


def label(ladder: Ladder, rung: str) -> str:
    """Return the name of a rung in tables, with its severity if it is on the curve.

    The word and hyphen that the names of all rungs begin with are left out.
    """
    first = rung.split("-")[0] + "-"
    common = len(ladder.rungs) > 1 and all(name.startswith(first) for name in ladder.rungs)
    name = printable(rung.removeprefix(first) if common else rung)
    if rung not in ladder.severities or name.startswith("severity"):
        return name
    return f"{name} (severity {ladder.severities[rung]:g})"


def draw(ladder: Ladder) -> Figure:
    """B on every rung with the area under it, B against severity, and the real sensors."""
    figure = new_figure(PAGE, 2.4 + 0.19 * len(ladder.rungs))
    sets = list(dict.fromkeys(rung for rung, _ in ladder.real))
    if not ladder.severities and not sets:
        _draw_losses(figure.subplots(), ladder)
        return figure
    left, right = np.ravel(figure.subfigures(1, 2, squeeze=False, width_ratios=(1.5, 1)))
    _draw_losses(left.subplots(), ladder)
    heights = [2.6] * bool(ladder.severities) + [1.0] * len(sets)
    panels = right.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    if ladder.severities:
        _draw_curves(panels[0], ladder)
    for axes, rung in zip(panels[len(panels) - len(sets) :], sets, strict=True):
        _draw_real(axes, ladder, rung, last=rung == sets[-1])
    return figure


def _draw_losses(axes: Axes, ladder: Ladder) -> None:
    """A table in colours: rungs and areas down, methods across, B written into each cell."""
    areas = _areas(ladder)
    rows = [*(label(ladder, rung) for rung in ladder.rungs), *areas]
    value, loss = np.full((2, len(rows), len(ladder.methods)), np.nan)
    value[len(ladder.rungs) :] = np.reshape(list(areas.values()), (-1, len(ladder.methods)))
    for (rung, method), step in ladder.steps.items():
        place = ladder.rungs.index(rung), ladder.methods.index(method)
        value[place] = step.value.value
        loss[place] = np.nan if step.loss is None else max(step.loss.value, 0.0)
    most = float(np.nanmax([0.05, *loss.flat]))
    shown = axes.imshow(loss, cmap="YlOrRd", aspect="auto", vmin=0, vmax=most)
    size = min(6.0, 110 / len(ladder.methods))  # so that numbers of neighbours do not touch
    for (i, j), number in np.ndenumerate(value):
        if not math.isnan(number):
            axes.text(
                j, i, f"{number:.2f}".removeprefix("0"), ha="center", va="center", fontsize=size,
                color="white" if loss[i, j] > 0.6 * most else "black",
            )  # fmt: skip
    names = [printable(method) for method in ladder.methods]
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title("B (0 to 1) on each rung; colour: lost against the ideal sensor", loc="left")
    axes.figure.colorbar(shown, ax=axes, location="bottom", shrink=0.5, aspect=30, label="B lost")


def _draw_curves(axes: Axes, ladder: Ladder) -> None:
    severities = list(ladder.severities.values())
    # Methods with the same images have one line.
    drawn: dict[tuple[float, ...], str] = {}
    for method in ladder.methods:
        if (method, False) in ladder.curves:
            drawn.setdefault(tuple(ladder.curves[method, False].tolist()), method)
    for k, (curve, method) in enumerate(drawn.items()):
        if k < _FIRST:
            axes.plot(severities, curve, **line_style(k), ms=3, lw=1.2, label=plain_label(method))
        else:
            label = "other methods" if k == _FIRST else None
            axes.plot(severities, curve, lw=0.8, color="0.75", zorder=1, label=label)
    axes.set_xlabel("severity of all imperfections")
    axes.set_ylabel("B")
    axes.grid(alpha=0.3, lw=0.4)
    axes.legend(
        fontsize=5.5, frameon=False, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0),
        handlelength=2.4, labelspacing=0.25, columnspacing=1,
    )  # fmt: skip


def _draw_real(axes: Axes, ladder: Ladder, rung: str, *, last: bool) -> None:
    """Nominal and calibrated figures of one recorded set; what is what stands below the `last`."""
    reals = [ladder.real.get((rung, method)) for method in ladder.methods]
    places = range(len(reals))
    nominal = [math.nan if real is None or real.value is None else real.value for real in reals]
    calibrated = [
        math.nan if real is None or real.calibrated is None else real.calibrated for real in reals
    ]
    axes.plot(places, nominal, "o", ms=3.5, color=COLOURS[0], label="as recorded")
    axes.plot(places, calibrated, "o", ms=6, mfc="none", color=COLOURS[1], label="calibrated")
    axes.margins(y=0.15)
    if last:
        axes.legend(fontsize=5.5, frameon=False, loc="best", handletextpad=0.2)
    names = [printable(method) if last else "" for method in ladder.methods]
    axes.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor")
    axes.tick_params(axis="x", labelsize=6)
    axes.set_title(_titled(ladder, rung), loc="left")
    axes.grid(alpha=0.3, lw=0.4)
