"""One image of a sensor, as it lies: in millimetres, with its electrodes, the truth beside it."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from eitbench.reports.figures.style import CONDUCTIVITY_MAP, HEADING, NOTE
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from eitbench.scenarios.sensors.sensor import Sensor

_MM = 1e3
_RIM_POINTS = 400


class _Shown(Figure):
    """A figure that a notebook shows, whatever its settings of Matplotlib are."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def plot(image: ArrayLike, sensor: Sensor | str, truth: ArrayLike | None = None) -> Figure:
    """Draw an image of conductivity as it lies on the sensor, with the truth beside it.

    Both have the same scale of colours. x grows to the right and y upwards, in millimetres; the
    numbers on the rim are those of the electrodes.

    Args:
        image: (H, W) [S/m]; the row index grows with y.
        sensor: the nominal sensor, or its name.
        truth: (H, W) [S/m], if it is known.

    Raises:
        InputError: an unknown sensor, or an image of another shape than its grid.
    """
    nominal = sensor_by_name(sensor) if isinstance(sensor, str) else sensor
    images = {"estimate": image} if truth is None else {"truth": truth, "estimate": image}
    drawn = {title: np.asarray(values, dtype=np.float64) for title, values in images.items()}
    for title, values in drawn.items():
        if values.shape != nominal.image_shape:
            raise InputError(
                f"Sensor {nominal.name!r} has images of shape {nominal.image_shape}, but the "
                f"{title} has shape {values.shape}: give one image, not a stack."
            )
    inside = np.array([values[nominal.mask] for values in drawn.values()])
    x0, y0, x1, y1 = (_MM * bound for bound in nominal.outline.bounds)
    height = 3.2 * (y1 - y0) / (x1 - x0) + 0.8
    figure = _Shown(figsize=(3.6 * len(drawn) + 0.8, height), layout="constrained", dpi=110)
    all_axes = figure.subplots(1, len(drawn), squeeze=False)[0]
    for axes, (title, values) in zip(all_axes, drawn.items(), strict=True):
        shown = axes.imshow(
            np.where(nominal.mask, values, np.nan),
            origin="lower",
            extent=(x0, x1, y0, y1),
            cmap=CONDUCTIVITY_MAP,
            vmin=np.nanmin(inside),
            vmax=np.nanmax(inside),
        )
        _draw_rim(axes, nominal)
        axes.set_title(title, fontsize=HEADING)
        axes.set_xlabel("x [mm]", fontsize=HEADING)
        axes.set_ylabel("y [mm]", fontsize=HEADING)
        axes.tick_params(labelsize=NOTE)
        axes.spines[:].set_visible(False)
    bar = figure.colorbar(shown, ax=list(all_axes))
    bar.set_label("conductivity [S/m]", fontsize=HEADING)
    bar.ax.tick_params(labelsize=NOTE)
    return figure


def _draw_rim(axes: Axes, sensor: Sensor) -> None:
    """Draw the outline, and the electrodes as bars on it, with their numbers inside it."""
    outline = sensor.outline
    around = np.linspace(0, outline.perimeter, _RIM_POINTS + 1)
    rim = _MM * outline.point(np.sort(np.concatenate([around, outline.corners])))
    axes.plot(*rim.T, color="0.4", lw=0.8, clip_on=False)
    x0, y0, x1, y1 = (_MM * bound for bound in outline.bounds)
    apart = 0.05 * max(x1 - x0, y1 - y0)
    for number, electrode in enumerate(sensor.electrodes):
        ends = electrode.centre + electrode.width * np.array([-0.5, 0.5])
        bar = _MM * outline.point(np.linspace(ends[0], ends[1], 9))
        axes.plot(*bar.T, color="black", lw=3, solid_capstyle="butt", clip_on=False)
        # Inwards of the rim, which runs counter-clockwise: to the left of it.
        along = bar[-1] - bar[0]
        inwards = np.array([-along[1], along[0]]) / np.hypot(*along)
        place = _MM * outline.point(electrode.centre) + apart * inwards
        axes.text(
            place[0], place[1], str(number), fontsize=NOTE, ha="center", va="center", color="white",
            bbox={"boxstyle": "round,pad=0.1", "fc": "0.25", "ec": "none", "alpha": 0.6},
        )  # fmt: skip
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
