"""Maps of the error of the place over sensors, with their rims and electrodes."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from eitbench.reports.figures.style import new_figure, plain_label

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ERROR_MAP = "YlOrRd"  # of ColorBrewer, for colour-blind readers; light is a small error
_SMALL = 6.5


def error_maps_figure(
    panels: Sequence[tuple[str, Mapping[str, Any], Mapping[str, Any]]], width: float, across: int
) -> Figure:
    """Draw maps on one scale, `across` in a row, in a figure `width` [in] wide.

    Args:
        panels: for each a title over those of method and median error, "" for none; what
            `error_maps` returned; and one of the `maps` in it.
    """
    down = -(-len(panels) // across)
    side = width / across
    figure = new_figure(width, down * (side + 0.28) + 0.5)
    axes = figure.subplots(down, across, squeeze=False)
    images = [np.array(of["error"], dtype=float) for _, _, of in panels]
    top = float(np.nanquantile(np.concatenate([image.ravel() for image in images]), 0.95))
    for place in axes.flat:
        place.set_axis_off()
    for place, (title, about, of), image in zip(axes.flat, panels, images, strict=False):
        x, y, step = about["edges"]
        rows, columns = image.shape
        place.set_aspect("equal")
        shown = place.pcolormesh(
            x + step * np.arange(columns + 1), y + step * np.arange(rows + 1), image,
            cmap=_ERROR_MAP, vmin=0, vmax=top, rasterized=True,
        )  # fmt: skip
        place.plot(*np.transpose(about["outline"]), color="0.5", lw=0.6)
        electrodes = np.array(about["electrodes"])
        place.plot(*electrodes.T, "o", ms=1.8, color="0.2", mew=0)
        place.plot(*electrodes[0], "o", ms=3.2, mfc="white", mec="0.2", mew=0.8)
        lines = [textwrap.shorten(plain_label(line), 26) for line in (title, of["method"]) if line]
        lines[-1] += f": {of['median']:.1f} mm"
        place.set_title("\n".join(lines), fontsize=_SMALL, pad=2)
    scale = figure.colorbar(
        shown, ax=axes, location="bottom", shrink=0.6, aspect=35, pad=0.02, extend="max"
    )
    scale.ax.tick_params(labelsize=_SMALL, length=2)
    scale.set_label(
        "median error of the place [mm]; the open circle is electrode 0", fontsize=_SMALL
    )
    return figure
