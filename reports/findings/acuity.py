"""Tactile acuity: one table of all methods, and a page of maps for each method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.acuity import acuity_of
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.figures.style import COLOURS, NOTE, PAGE, new_figure
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from eitbench.benchmark.analysis.results import Run
    from eitbench.benchmark.findings.acuity import AcuityResult

_NONE = "–"
LEGEND = (
    "A touch is detected if its image is stronger than a threshold for 1 % of false alarms, from "
    "frames without a touch of the same method and noise. "
    "AUC: area under detections over false alarms, touches of all "
    "pressures together. Smallest touch: detected in half of the trials, median over the places; "
    "as pressure, and as contrast times area; – where half of the places never feel one. Error: "
    "median of the place of detected touches. Pull: share of its distance from the centre that a "
    "touch loses in the image, with its 95 % interval over places; negative where it is pushed "
    "out. Two points: least distance from which on 90 % of the pairs are told apart, by the rule "
    "of two touches at once; in the truth: the same of the true images, which no method can be "
    "held to beat. False pairs: detected single touches that are shown as several. "
    "Linearity: R² of shown over true strength at a place, median. Unevenness: standard deviation "
    "of the slope of shown over true strength over the places, divided by its mean."
)
MAP_LEGEND = (
    "Maps over the sensor, one row for each noise level; grey crosses: nothing detected, or pairs "
    "not told apart; in the third column also places around which no pair has room. Arrows: mean "
    "displacement of the place of detected touches, to the scale of the axes. Two points: least "
    "distance from which on all pairs around the place, in two directions, are told apart. Slope: "
    "shown over true strength."
)


def findings(run: Run) -> list[Finding]:
    """Return the table of a run's acuity, and the maps of each method; none of other runs."""
    results = acuity_of(run) if run.kind == METHOD_RUNS else []
    if not results:
        return []
    found = [Finding("acuity", "Tactile acuity", to_table(results), grid(results), LEGEND)]
    cells = list(dict.fromkeys((one.scenario, one.method) for one in results))
    several = len({scenario for scenario, _ in cells}) > 1
    for scenario, method in cells:
        of = [one for one in results if (one.scenario, one.method) == (scenario, method)]
        name = f"{scenario}-{method}" if several else method
        title = f"Tactile acuity: {printable(name)}"
        shows = "Maps of the smallest touch, the place, two points and the slope; ROC curves"
        maps = places_table(of)
        stem = f"acuity-{name}"
        found.append(Finding(stem, title, maps, place_grid(maps), MAP_LEGEND, draw(of), shows))
    return found


def to_table(results: Sequence[AcuityResult]) -> pd.DataFrame:
    """All figures: a row for each scenario, method and noise level."""
    return pd.DataFrame(
        [
            {"scenario": one.scenario, "method": one.method, "snr_db": one.snr_db, **one.figures}
            for one in results
        ]
    )


def places_table(results: Sequence[AcuityResult]) -> pd.DataFrame:
    """The maps as a table: a row for each noise level and place."""
    return pd.concat(
        [
            pd.DataFrame(
                {
                    "snr_db": one.snr_db,
                    "x_mm": 1e3 * one.place[:, 0],
                    "y_mm": 1e3 * one.place[:, 1],
                    "smallest_pa": one.smallest_pa,
                    "smallest_s_mm2": one.smallest_s_mm2,
                    "error_mm": one.error_mm,
                    "bias_x_mm": one.bias_mm[:, 0],
                    "bias_y_mm": one.bias_mm[:, 1],
                    "least_mm": one.least_mm,
                    "gain": one.gain,
                }
            )
            for one in results
        ],
        ignore_index=True,
    )


def grid(results: Sequence[AcuityResult]) -> list[list[str]]:
    """Return the table as texts, its heads first; the least noise first."""
    rows = [
        [
            "SNR [dB]", "method", "AUC", "smallest touch [kPa]", "[S/m mm²]", "error [mm]",
            "pull to the centre (95 %)", "two points [mm]", "in the truth", "false pairs",
            "linearity", "unevenness",
        ]
    ]  # fmt: skip
    for one in sorted(results, key=lambda one: -one.snr_db):
        of = one.figures
        pull = f"{of['pull']:z.0%} ({of['pull_low']:z.0%} to {of['pull_high']:z.0%})"
        rows.append(
            [
                f"{one.snr_db:g}",
                printable(one.method),
                _number(of["auc"], ".3f"),
                _number(of["smallest_pa"] / 1e3, ".2g"),
                _number(of["smallest_s_mm2"], ".3g"),
                _number(of["error_mm"], ".1f"),
                _NONE if np.isnan(of["pull"]) else pull,
                _number(of["least_mm"], ".0f"),
                _number(of["truth_least_mm"], ".0f"),
                _number(of["false_pairs"], ".0%"),
                _number(of["linearity"], ".3f"),
                _number(of["unevenness"], ".2f"),
            ]
        )
    return rows


def place_grid(table: pd.DataFrame) -> list[list[str]]:
    """Return medians and ends of the maps over the places as texts, its heads first."""
    rows = [["SNR [dB]", "map", "least", "median", "greatest", "places without"]]
    kinds = (
        ("smallest_pa", "smallest touch [Pa]", ".0f"),
        ("error_mm", "error of the place [mm]", ".1f"),
        ("least_mm", "two points [mm]", ".0f"),
        ("gain", "slope of the strength", ".2g"),
    )
    for level, of in sorted(table.groupby("snr_db"), key=lambda item: -float(str(item[0]))):
        for column, title, form in kinds:
            ends = (of[column].min(), of[column].median(), of[column].max())
            texts = [_number(float(value), form) for value in ends]
            rows.append([f"{level:g}", title, *texts, str(int(of[column].isna().sum()))])
    return rows


def _number(value: float, form: str) -> str:
    return _NONE if np.isnan(value) else format(value, form)


def draw(results: Sequence[AcuityResult]) -> Figure:
    """Four maps and the ROC of a method, a row for each noise level; a map's rows share a scale."""
    rows = sorted(results, key=lambda one: -one.snr_db)
    figure = new_figure(PAGE, 0.6 + 1.55 * len(rows))
    panels = figure.subplots(len(rows), 5, squeeze=False)
    maps: list[tuple[str, list[NDArray[np.float64]], str]] = [
        ("smallest touch [kPa]", [one.smallest_pa / 1e3 for one in rows], "viridis_r"),
        ("error of the place [mm]", [one.error_mm for one in rows], "viridis_r"),
        ("two points [mm]", [one.least_mm for one in rows], "viridis_r"),
        ("slope of the strength", [one.gain for one in rows], "viridis"),
    ]
    for k, (title, values, colours) in enumerate(maps):
        known = np.concatenate(values)
        known = known[np.isfinite(known)]
        ends = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        for row, (one, value) in enumerate(zip(rows, values, strict=True)):
            axes = panels[row, k]
            shown = _map(axes, one, value, ends, colours)
            if k == 1:
                _arrows(axes, one)
        panels[0, k].set_title(title, fontsize=NOTE)
        figure.colorbar(shown, ax=list(panels[:, k]), location="bottom", shrink=0.9, aspect=18)
    for row, one in enumerate(rows):
        panels[row, 0].set_ylabel(f"{one.snr_db:g} dB", fontsize=NOTE + 1)
        axes = panels[row, 4]
        axes.plot(*one.roc, color=COLOURS[0], lw=1.2)
        axes.plot([0, 1], [0, 1], color="0.7", lw=0.6, ls="--")
        axes.set_aspect("equal")
        axes.set_xticks([0, 1])
        axes.set_yticks([0, 1])
        axes.tick_params(labelsize=NOTE - 1)
        axes.text(0.96, 0.08, f"AUC {one.figures['auc']:.3f}", ha="right", fontsize=NOTE - 1)
    panels[0, 4].set_title("ROC", fontsize=NOTE)
    return figure


def _map(
    axes: Axes,
    one: AcuityResult,
    value: NDArray[np.float64],
    ends: tuple[float, float],
    colours: str,
) -> Any:
    """Draw the values (k,) at the lattice's places as squares as large as its step [mm]."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    place = 1e3 * one.place
    apart = np.abs(place[:, None] - place[None]).max(axis=2)
    step = float(apart[apart > 0].min())
    known = np.isfinite(value)
    squares = [Rectangle((x - step / 2, y - step / 2), step, step) for x, y in place[known]]
    shown = PatchCollection(squares, cmap=colours, linewidths=0)
    shown.set_array(value[known])
    shown.set_clim(*ends)
    axes.add_collection(shown)
    axes.plot(*place[~known].T, "x", color="0.6", ms=3, mew=0.7)
    low, high = place.min(axis=0) - step, place.max(axis=0) + step
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    return shown


def _arrows(axes: Axes, one: AcuityResult) -> None:
    axes.quiver(
        *(1e3 * one.place.T), *one.bias_mm.T, angles="xy", scale_units="xy", scale=1,
        color=COLOURS[1], width=0.012, zorder=3,
    )  # fmt: skip
