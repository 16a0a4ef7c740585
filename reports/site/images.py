"""Pictures of the site: strips of truth and image, and figures over noise."""

from __future__ import annotations

import io
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from eitbench.benchmark.metrics.specs import METRICS
from eitbench.reports.figures.style import COLOURS, CONDUCTIVITY_MAP, STYLE, new_figure, svg
from eitbench.reports.page.images import unpacked
from eitbench.reports.tables.ceiling import ceiling_rows

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from numpy.typing import NDArray

    from eitbench.reports.page.report_data import BoardData

GAP = 4  # pixels between two images
_TRUTH = "truth"
_HIDDEN = (0, 0, 0, 0)


def extremes(board: BoardData, label: str) -> tuple[int, int] | None:
    """Positions, among the images of a board, of the best and the worst one of a method.

    They are those by the figure that ranks; None where there are no two images with one.
    """
    images, by = board["images"], board["ranked_by"]
    if images is None or label not in images["names"]:
        return None
    figures = [of.get(by) for of in images["figures"].get(label, ())]
    known = [k for k, value in enumerate(figures) if value is not None]
    if len(known) < 2:
        return None
    lower_is_better = METRICS[by].best == "min"
    known.sort(key=lambda k: figures[k], reverse=not lower_is_better)
    return known[0], known[-1]


def strip(images: Mapping[str, Any], label: str, positions: Sequence[int]) -> bytes:
    """A PNG of images side by side, each after its truth where that is known."""
    from matplotlib import colormaps, pyplot

    values = unpacked(images)
    names = [_TRUTH, label] if images["has_truth"] else [label]
    low, high = images["low"], images["high"]
    panels: list[NDArray[np.uint8]] = []
    for position in positions:
        for name in names:
            image = values[images["names"].index(name), position][::-1]  # row 0 is the bottom
            colours = colormaps[CONDUCTIVITY_MAP]((image - low) / (high - low), bytes=True)
            colours[~np.isfinite(image)] = _HIDDEN
            gap = np.zeros((len(colours), GAP, 4), dtype=np.uint8)
            panels += [gap] * bool(panels) + [colours]
    file = io.BytesIO()
    pyplot.imsave(file, np.concatenate(panels, axis=1), format="png")
    return file.getvalue()


def over_noise(boards: Sequence[BoardData], label: str) -> bytes | None:
    """An SVG of PSNR against the noise of a suite, one method before all others and the ceiling.

    None where it is on fewer than three levels, or where scenarios of one level differ otherwise.
    """
    import matplotlib as mpl

    known = [
        (float(level), board)
        for board in boards
        if isinstance(level := board["snr_db"], int | float)
    ]
    known.sort(key=itemgetter(0))
    if len(dict(known)) < len(known):
        return None
    curves: dict[str, list[tuple[float, float]]] = {}
    ceiling: list[tuple[float, float]] = []
    for level, board in known:
        rows = board["views"][0]["rows"]
        ceiling += [(level, row["psnr"]) for row in ceiling_rows(rows)]
        for row in rows:
            if row.get("psnr") is not None:
                curves.setdefault(row["label"], []).append((level, row["psnr"]))
    if len(curves.get(label, ())) < 3:
        return None
    with mpl.rc_context(STYLE):
        figure = new_figure(4.2, 2.6)
        axes = figure.subplots()
        for name, points in curves.items():
            chosen = name == label
            axes.plot(
                *zip(*points, strict=True),
                color=COLOURS[0] if chosen else "0.75",
                linewidth=2.5 if chosen else 0.8,
                marker="o" if chosen else None,
                zorder=3 if chosen else 1,
            )
        if len(ceiling) > 1:
            axes.plot(*zip(*ceiling, strict=True), color="0.3", linewidth=1.2, linestyle="--")
        axes.set(xlabel="SNR of a frame [dB]", ylabel="PSNR [dB]")
        axes.grid(color="0.92")
        return svg(figure)
