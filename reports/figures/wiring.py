"""Measured beside modelled frame, before and after the wiring is put right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eitbench.reports.figures.style import COLOURS, PAGE, new_figure, plain_label

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, eq=False)
class WiringFrames:
    """What the figure shows.

    Attributes:
        measured: (M,) the frame, in the board's units.
        before: (M,) what the sensor as declared predicts; None where it has another length.
        after: (M,) what the answer predicts.
        before_misfit, after_misfit: of both.
        sensor: name of the declared sensor.
        refused: there is no answer; `after` is the best one.
        noise: (M,) standard deviation of each value from frame to frame; NaN for one frame.
    """

    measured: Array
    before: Array | None
    after: Array
    before_misfit: float
    after_misfit: float
    sensor: str
    refused: bool
    noise: Array


def wiring_figure(frames: WiringFrames) -> Figure:
    """Draw both frames over the values, and measured over modelled values, before and after.

    Below them stands the noise of each value, where several frames show it.
    """
    noisy = bool(np.isfinite(frames.noise).all() and frames.noise.any())
    figure = new_figure(PAGE, 5.8 if noisy else 4.2)
    axes = figure.subplots(3 if noisy else 2, 2, width_ratios=(3, 1), squeeze=False)
    after = "best wiring, refused" if frames.refused else "wiring put right"
    rows = (
        (f"{plain_label(frames.sensor)} as declared", frames.before, frames.before_misfit),
        (after, frames.after, frames.after_misfit),
    )
    index = np.arange(len(frames.measured))
    if noisy:
        line, histogram = axes[2]
        line.set_title("noise of each value", loc="left")
        line.set(xlabel="value of the frame", ylabel="std [board's unit]")
        line.plot(index, frames.noise, ".", ms=3, color=COLOURS[0])
        line.margins(x=0.01)
        histogram.hist(frames.noise, bins=30, orientation="horizontal", color=COLOURS[0])
        histogram.set(xlabel="values")
    for (line, scatter), (title, modelled, misfit) in zip(axes[:2], rows, strict=True):
        line.set_title(title, loc="left")
        line.set(xlabel="value of the frame", ylabel="voltage [board's unit]")
        line.plot(index, frames.measured, color=COLOURS[0], lw=0.8, label="measured")
        line.margins(x=0.01)
        scatter.set(xlabel="modelled", ylabel="measured")
        if modelled is None:
            line.set_title(f"{title}: another number of values", loc="left")
            scatter.set_axis_off()
            continue
        line.plot(index, modelled, color=COLOURS[1], lw=0.8, ls="--", label="modelled")
        line.legend(loc="lower right", bbox_to_anchor=(1, 0.97), frameon=False, ncols=2)
        scatter.set_title(f"misfit {misfit:.1%}")
        scatter.plot(modelled, frames.measured, ".", ms=3, color=COLOURS[0])
        ends = [float(modelled.min()), float(modelled.max())]
        scatter.plot(ends, ends, color="0.5", lw=0.8)
    return figure
