"""Tactile acuity: one table of all methods, and a page of maps for each method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from eitbench.benchmark.findings.acuity import acuity_of
from eitbench.benchmark.findings.acuity_seen import GREIT
from eitbench.benchmark.findings.acuity_specs import ACUITY_SPECS
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.figures.style import COLOURS, NOTE, PAGE, line_style, new_figure
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.columns import printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.collections import PatchCollection
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from eitbench.benchmark.analysis.results import Run
    from eitbench.benchmark.findings.acuity import AcuityResult
    from eitbench.benchmark.findings.acuity_specs import Table

LEGEND = (
    "A touch is detected if its image is stronger than a threshold for 1 % of false alarms, from "
    "frames without a touch of the same method and noise (99 at least, or nothing counts as "
    "detected). Methods are tuned for each level by S, "
    "the score of images; a sharper image can cost detection, so that a method may feel lighter "
    "touches at more noise. The cards of the metrics have formulas and traps."
)
GREIT_LEGEND = (
    "Figures of merit of GREIT (Adler et al. 2009), as EIDORS computes them, of the firmest "
    "touches. The figure shows medians by the distance of the place from the rim, a row for each "
    "noise level; dotted: the value of a right image, where there is one; a figure that is the "
    "same everywhere is not drawn. The cards of the metrics have formulas and traps."
)
MAP_LEGEND = (
    "Maps over the sensor, one row for each noise level; grey crosses: nothing detected, or pairs "
    "not told apart; empty: no pair has room. Colours of the error end at its 95th percentile. "
    "Arrows: mean displacement of the place of detected touches, to the scale of the axes. Two "
    "points: least distance from which on all pairs around the place, in four directions as far as "
    "there is room, are told apart. Slope: shown over true strength. Below: GREIT's figures of "
    "merit of the firmest touches; one that is the same everywhere is not drawn."
)
_MAPS = {
    "smallest_pa": "smallest touch [kPa]",
    "error_mm": "error of the place [mm]",
    "least_mm": "two points [mm]",
    "gain": "slope of the strength",
    "amplitude": "amplitude response",
    "position_error_mm": "position error [mm]",
    "resolution": "resolution",
    "shape_deformation": "shape deformation",
    "ringing": "ringing",
}
"""Maps over the sensor, by their columns."""
_COLUMNS = 5


def findings(run: Run) -> list[Finding]:
    """Return the table of a run's acuity, and the maps of each method; none of other runs."""
    results = acuity_of(run) if run.kind == METHOD_RUNS else []
    if not results:
        return []
    found = [
        Finding("acuity", "Tactile acuity", to_table(results), grid(results, "acuity"),
                LEGEND),
        Finding("acuity-merit", "GREIT's figures of merit", places_table(results),
                grid(results, "greit"), GREIT_LEGEND,
                draw_depths(results), "Figures of merit over the distance from the rim"),
    ]  # fmt: skip
    for name in dict.fromkeys(one.method for one in results):
        of = [one for one in results if one.method == name]
        title = f"Tactile acuity: {printable(name)}"
        shows = "Maps of the smallest touch, the place, two points, the slope and GREIT's figures"
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
    """The maps as a table: a row for each scenario, method, noise level and place."""
    return pd.concat(
        [
            one.places.assign(scenario=one.scenario, method=one.method, snr_db=one.snr_db)
            for one in results
        ],
        ignore_index=True,
    )


def grid(results: Sequence[AcuityResult], table: Table) -> list[list[str]]:
    """Return a table as texts, its heads first; the least noise first."""
    specs = [spec for spec in ACUITY_SPECS.values() if spec.table == table]
    rows = [["SNR [dB]", "method", *(spec.heading for spec in specs)]]
    for one in sorted(results, key=lambda one: -one.snr_db):
        texts = {spec.name: spec.text(one.figures[spec.name]) for spec in specs}
        if "pull" in texts and not np.isnan(one.figures["pull"]):
            low, high = one.figures["pull_low"], one.figures["pull_high"]
            texts["pull"] += f" ({low:z.0%} to {high:z.0%})"
        rows.append([f"{one.snr_db:g}", printable(one.method), *texts.values()])
    return rows


def place_grid(table: pd.DataFrame) -> list[list[str]]:
    """Return medians and ends of the maps over the places as texts, its heads first."""
    rows = [["SNR [dB]", "map", "least", "median", "greatest", "places without"]]
    for level, of in sorted(table.groupby("snr_db"), key=lambda item: -float(str(item[0]))):
        for column, title in _MAPS.items():
            known = of[column].to_numpy(np.float64) / _scale(column)
            ends = (np.nanmin(known), np.nanmedian(known), np.nanmax(known)) if (
                np.isfinite(known).any()
            ) else ()  # fmt: skip
            texts = [f"{value:z.3g}" for value in ends] or ["–"] * 3
            rows.append([f"{level:g}", title, *texts, str(int(of[column].isna().sum()))])
    return rows


def _scale(column: str) -> float:
    """Of the stored value, one unit of the map."""
    return 1e3 if column == "smallest_pa" else 1.0


def draw_depths(results: Sequence[AcuityResult]) -> Figure:
    """GREIT's figures over the distance from the rim [mm]: a row a level, a line a method."""
    levels = sorted({one.snr_db for one in results}, reverse=True)
    figure = new_figure(PAGE, 0.9 + 1.45 * len(levels))
    names = _varied(results)
    panels = figure.subplots(len(levels), len(names), squeeze=False, sharex=True, sharey="col")
    methods = list(dict.fromkeys(one.method for one in results))
    for one in results:
        at = one.places.groupby(one.places["depth_mm"].round(0))
        k = methods.index(one.method)
        for axes, name in zip(panels[levels.index(one.snr_db)], names, strict=True):
            by = at[name].median()
            axes.plot(by.index, by, **line_style(k), ms=3.5, lw=1, label=printable(one.method))
    for row, level in zip(panels, levels, strict=True):
        row[0].set_ylabel(f"{level:g} dB", fontsize=NOTE + 1)
        for axes, name in zip(row, names, strict=True):
            axes.tick_params(labelsize=NOTE - 1)
            if (right := ACUITY_SPECS[name].right) is not None:
                axes.axhline(right, color="0.5", lw=0.7, ls=":", zorder=0)
    for axes, name in zip(panels[0], names, strict=True):
        axes.set_title(_MAPS[name], fontsize=NOTE)
    for axes in panels[-1]:
        axes.set_xlabel("distance from the rim [mm]", fontsize=NOTE - 1)
    lines = dict(zip(*reversed(panels[0][0].get_legend_handles_labels()), strict=True))
    figure.legend(
        lines.values(), lines.keys(), loc="outside lower center", ncols=min(len(methods), 5),
        fontsize=NOTE,
    )  # fmt: skip
    return figure


def draw(results: Sequence[AcuityResult]) -> Figure:
    """The maps and the ROC of a method, a row for each noise level; rows of a map share a scale."""
    rows = sorted(results, key=lambda one: -one.snr_db)
    columns = [name for name in _MAPS if name not in GREIT]
    figure = new_figure(PAGE, 2 * (0.55 + 1.4 * len(rows)))
    tactile, greit = figure.subfigures(2, 1, squeeze=False)[:, 0]
    panels = tactile.subplots(len(rows), _COLUMNS, squeeze=False)
    _draw_maps(tactile, panels[:, : len(columns)], rows, columns)
    varied = _varied(rows)
    merits = greit.subplots(len(rows), _COLUMNS, squeeze=False)
    _draw_maps(greit, merits[:, : len(varied)], rows, varied)
    for axes in merits[:, len(varied) :].flat:
        axes.set_axis_off()
    for axes, one in zip(panels[:, -1], rows, strict=True):
        axes.plot(*one.roc, color=COLOURS[0], lw=1.2)
        axes.plot([0, 1], [0, 1], color="0.7", lw=0.6, ls="--")
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.text(0.96, 0.08, f"AUC {one.figures['auc']:.3f}", ha="right", fontsize=NOTE - 1)
        axes.set_ylabel("detected, 0 to 1", fontsize=NOTE - 1)
    panels[0, -1].set_title("ROC", fontsize=NOTE)
    panels[-1, -1].set_xlabel("false alarms, 0 to 1", fontsize=NOTE - 1)
    return figure


def _varied(results: Sequence[AcuityResult]) -> list[str]:
    """GREIT's figures that are not the same everywhere, or all of them."""
    places = pd.concat([one.places[list(GREIT)] for one in results])
    return [name for name in GREIT if places[name].nunique() > 1] or list(GREIT)


def _draw_maps(
    figure: Any, panels: Any, rows: Sequence[AcuityResult], columns: Sequence[str]
) -> None:
    """Draw a map of each of the columns, and the scale below them."""
    for k, name in enumerate(columns):
        values = [one.places[name].to_numpy(np.float64) / _scale(name) for one in rows]
        norm, extend = _norm(name, np.concatenate(values))
        for axes, one, value in zip(panels[:, k], rows, values, strict=True):
            tried = one.places["room_mm" if name == "least_mm" else "x_mm"].notna().to_numpy()
            shown = _map(axes, one, value, tried, norm, _COLOURS_OF.get(name, "viridis_r"))
        scale = figure.colorbar(
            shown, ax=list(panels[:, k]), location="bottom", shrink=0.9, aspect=18, extend=extend
        )
        scale.ax.tick_params(labelsize=NOTE - 1)
        if name == "smallest_pa":  # few labels have room on a logarithmic scale
            ends = np.unique(norm.inverse(np.linspace(0, 1, 3)))
            scale.set_ticks(ends, labels=[f"{end:.2g}" for end in ends], minor=False)
            scale.minorticks_off()
        panels[0, k].set_title(_MAPS[name], fontsize=NOTE)
    for axes, one in zip(panels[:, 0], rows, strict=True):
        axes.set_ylabel(f"{one.snr_db:g} dB", fontsize=NOTE + 1)
    if "error_mm" in columns:
        for axes, one in zip(panels[:, list(columns).index("error_mm")], rows, strict=True):
            axes.quiver(
                one.places["x_mm"], one.places["y_mm"], one.places["bias_x_mm"],
                one.places["bias_y_mm"], angles="xy", scale_units="xy", scale=1,
                color=COLOURS[1], width=0.012, zorder=3,
            )  # fmt: skip


_COLOURS_OF = {"gain": "viridis", "amplitude": "RdBu_r", "position_error_mm": "RdBu_r"}


def _norm(name: str, values: NDArray[np.float64]) -> tuple[Normalize, str]:
    """Return the scale of the colours of a map, and which of its ends values may pass."""
    from matplotlib.colors import LogNorm, Normalize

    known = values[np.isfinite(values)]
    if not len(known):
        return Normalize(0, 1), "neither"
    low, high = float(known.min()), float(known.max())
    if name == "smallest_pa" and 0 < low < high:
        return LogNorm(low, high), "neither"
    if low == high:
        return Normalize(low, low + 1), "neither"
    if (right := ACUITY_SPECS[name].right if name in GREIT else None) is not None:
        most = float(np.quantile(np.abs(known - right), _MOST)) or 1.0
        return Normalize(right - most, right + most), "both"
    if name in ("error_mm", "ringing"):
        return Normalize(low, float(np.quantile(known, _MOST))), "max"
    return Normalize(low, high), "neither"


_MOST = 0.95
"""Share of the values within the scale of colours, where single ones may be far off."""


def _map(
    axes: Axes,
    one: AcuityResult,
    value: NDArray[np.float64],
    tried: NDArray[np.bool_],
    norm: Normalize,
    colours: str,
) -> PatchCollection:
    """Draw the values (k,) at the lattice's places as squares as large as its step [mm].

    Where one is missing that was `tried`, there is a cross.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Rectangle

    place = one.places[["x_mm", "y_mm"]].to_numpy(np.float64)
    apart = np.abs(place[:, None] - place[None]).max(axis=2)
    step = float(apart[apart > 0].min())
    known = np.isfinite(value)
    squares = [Rectangle((x - step / 2, y - step / 2), step, step) for x, y in place[known]]
    shown = PatchCollection(squares, cmap=colours, norm=norm, linewidths=0)
    shown.set_array(value[known])
    axes.add_collection(shown)
    axes.plot(*place[~known & tried].T, "x", color="0.6", ms=3, mew=0.7)
    rim = 1e3 * one.outline
    # As a line: of a patch, matplotlib would keep the many points of a straight side.
    axes.plot(*np.concatenate([rim, rim[:1]]).T, color="0.6", lw=0.6)
    axes.set_xlim(rim[:, 0].min() - 1, rim[:, 0].max() + 1)
    axes.set_ylim(rim[:, 1].min() - 1, rim[:, 1].max() + 1)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    return shown
