"""The figure of designs: maps of their bounds, a row for each design, a column for each bound."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eitbench.benchmark.design.designs import median
from eitbench.reports.figures.style import PAGE, new_figure
from eitbench.reports.tables.design import MAPS, title

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from eitbench.benchmark.design.designs import Design

_SHOWN = {
    "place_mm": "place [mm]",
    "strength_percent": "strength [%]",
    "smallest_s_per_m_mm2": "smallest touch [S/m mm²]",
    "two_point_mm": "two points [mm]",
}
_SMALL = 6.5
ROWS = 6
"""Designs whose maps fit on a page."""


def drawn_designs(designs: Sequence[Design]) -> list[Design]:
    """The designs whose maps are drawn: all that are fast enough, or of more than `ROWS` the best.

    The best have the smallest bounds of the place; the sensor as it was given is always among them.
    """
    fast = [of for of in designs if of.maps is not None]
    ranked = sorted(fast, key=lambda of: (not of.given, median(of.maps.place if of.maps else None)))
    kept = ranked[:ROWS]
    return [of for of in fast if any(of is one for one in kept)]


def design_figure(designs: Sequence[Design]) -> Figure:
    """Draw the maps of the designs that are fast enough; one bound has one logarithmic scale.

    Of many designs the best are drawn (`drawn_designs`), and a line says so. White is where no
    touch has room, grey where two points are not told from one.
    """
    from matplotlib.colors import LogNorm

    shown = [(of, of.maps) for of in drawn_designs(designs) if of.maps is not None]
    x0, y0, x1, y1 = shown[0][0].sensor.outline.bounds
    side = PAGE / (len(_SHOWN) + 0.4)
    figure = new_figure(PAGE, len(shown) * side * (y1 - y0) / (x1 - x0) + 0.75)
    axes = figure.subplots(len(shown), len(_SHOWN), squeeze=False)
    for column, (name, heading) in enumerate(_SHOWN.items()):
        attribute, factor = MAPS[name]
        images = [factor * getattr(maps, attribute) for _, maps in shown]
        every = np.concatenate([image.ravel() for image in images])
        finite = every[np.isfinite(every)]
        low, high = np.quantile(finite, (0.02, 0.98)) if len(finite) else (1.0, 10.0)
        # A scale needs ends that differ, also for a sensor that is everywhere alike.
        scale = LogNorm(low, max(high, 1.25 * low))
        for row, ((of, maps), image) in enumerate(zip(shown, images, strict=True)):
            place = axes[row, column]
            place.set_aspect("equal")
            place.set_xticks([])
            place.set_yticks([])
            for spine in place.spines.values():
                spine.set_visible(False)
            none = np.where(np.isinf(image), 1.0, np.nan)
            grid = (1e3 * maps.x, 1e3 * maps.y)
            place.pcolormesh(*grid, none, cmap="Greys", vmin=0, vmax=3, rasterized=True)
            drawn = place.pcolormesh(
                *grid, np.where(np.isinf(image), np.nan, image),
                cmap="viridis_r", norm=scale, rasterized=True,
            )  # fmt: skip
            sensor = of.sensor
            rim = sensor.outline.point(np.linspace(0, sensor.outline.perimeter, 400))
            place.plot(*(1e3 * rim.T), color="0.5", lw=0.6)
            electrodes = sensor.outline.point([e.centre for e in sensor.electrodes])
            place.plot(*(1e3 * electrodes.T), "o", ms=1.8, color="0.2", mew=0)
            if row == 0:
                place.set_title(heading, fontsize=_SMALL + 0.5)
            if column == 0:
                place.set_ylabel(title(of).replace(", ", "\n"), fontsize=_SMALL)
        bar = figure.colorbar(
            drawn, ax=axes[:, column], location="bottom", shrink=0.9, aspect=18, pad=0.02,
            extend="both",
        )  # fmt: skip
        ticks = np.geomspace(scale.vmin or 1, scale.vmax or 1, 3)
        bar.set_ticks(ticks.tolist(), labels=[f"{tick:.{2 + (tick >= 99.5)}g}" for tick in ticks])
        bar.minorticks_off()
        bar.ax.tick_params(labelsize=_SMALL, length=2)
    if len(shown) < (fast := sum(of.maps is not None for of in designs)):
        own = ", with the sensor as it is given" if any(of.given for of, _ in shown) else ""
        figure.supxlabel(
            f"The {len(shown)} best of {fast} designs by the bound of the place{own}; the table "
            "has all.",
            fontsize=_SMALL,
        )
    return figure
