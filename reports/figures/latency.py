"""The figure of latencies: the strength that live images show around onset and release."""

from __future__ import annotations

from typing import TYPE_CHECKING
from warnings import catch_warnings, simplefilter

import numpy as np

from eitbench.reports.figures.style import COLOURS, PAGE, marker, new_figure, plain_label

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_COLUMNS = (
    ("after_onset_s", (-1.0, 3.5), (-5.0, 120.0), "a touch begins", "after onset [s]"),
    ("after_release_s", (-1.0, 3.5), (-5.0, 120.0), "it ends", "after release [s]"),
    ("after_release_s", (2.5, 20.5), (-1.0, 12.0), "what stays (enlarged)", "after release [s]"),
)
"""Clock, range of time [frames], range of strength [%], title and label of each column."""
_STEPS = 300
_APART = 6
"""Steps from a marker of one method to the next method's: no two cover each other."""


def latency_figure(images: pd.DataFrame, frame_s: float) -> Figure:
    """Draw what the newest live image shows at each time: a row for each pressure.

    Solid lines are medians over the touches and bands the middle half of them, in a material that
    drifts and relaxes; dotted lines are medians in an ideal one.

    Args:
        images: see `eitbench.hardware.live.latency.Latencies`.
        frame_s: time of a frame [s].
    """
    from matplotlib.lines import Line2D

    pressures = sorted(images["pressure_kpa"].unique())
    methods = list(images["method"].unique())
    figure = new_figure(PAGE, 0.55 + 1.5 * len(pressures))
    axes = figure.subplots(len(pressures), len(_COLUMNS), squeeze=False, sharex="col", sharey="col")
    for row, kpa in enumerate(pressures):
        for column, (clock, frames, strengths, title, label) in enumerate(_COLUMNS):
            place = axes[row, column]
            grid = frame_s * np.linspace(*frames, _STEPS)
            for k, method in enumerate(methods):
                of = images[(images["method"] == method) & (images["pressure_kpa"] == kpa)]
                real = _over_time(of[~of["ideal"]], clock, grid)
                ideal = _over_time(of[of["ideal"]], clock, grid)
                low, middle, high = _quartiles(real)
                colour = COLOURS[k % len(COLOURS)]
                place.fill_between(grid, low, high, color=colour, alpha=0.18, lw=0)
                place.plot(
                    grid, middle, color=colour, lw=1.2, label=plain_label(method),
                    marker=marker(k), ms=3, markevery=(_APART * k, _APART * len(methods)),
                )  # fmt: skip
                place.plot(grid, _quartiles(ideal)[1], color=colour, lw=0.9, ls=":")
            place.axhline(0, color="0.7", lw=0.5, zorder=0)
            if frames[0] < 0:
                place.axvline(0, color="0.7", lw=0.5, zorder=0)
            place.set_xlim(grid[0], grid[-1])
            place.set_ylim(*strengths)
            if row == 0:
                place.set_title(title)
            if row == len(pressures) - 1:
                place.set_xlabel(label)
        axes[row, 0].set_ylabel(f"{kpa:g} kPa\nstrength [%]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    handles += [Line2D([], [], color="0.4", ls=style, lw=1.1) for style in ("-", ":")]
    labels += ["material drifts and relaxes", "ideal material"]
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    return figure


def _over_time(images: pd.DataFrame, clock: str, grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Strength [%] of the newest image at each time [s]: (touches, times), NaN before the first."""
    courses = []
    for _, of in images.groupby("touch"):
        newest = np.searchsorted(of[clock].to_numpy(), grid, side="right") - 1
        strength = 100 * of["strength"].to_numpy()
        courses.append(np.where(newest < 0, np.nan, strength[newest]))
    return np.array(courses)


def _quartiles(courses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quartiles (3, times) over the touches; NaN where no touch has an image."""
    with catch_warnings():
        simplefilter("ignore", RuntimeWarning)  # of a method that fails on every touch
        return np.nanquantile(courses, (0.25, 0.5, 0.75), axis=0)
