"""Sensors as values: outline, electrodes, drive pattern, background and image grid."""

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.outlines import Outline, rectangle
from eitbench.scenarios.sensors.patterns import DrivePattern, offset_pattern


def content_hash(value: object) -> str:
    """SHA-256 (hex) of a JSON-able `value`, independent of the order of keys."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Electrode:
    """One electrode on the rim.

    Attributes:
        centre: arc length of its centre along the outline [m].
        width: length along the rim [m].
        contact_impedance: z, potential over current density [Ohm*m2], with conductivities in S/m.
    """

    centre: float
    width: float
    contact_impedance: float

    def __post_init__(self) -> None:
        sizes = (self.width, self.contact_impedance)
        if not (np.isfinite(self.centre) and all(0 < size < np.inf for size in sizes)):
            raise InputError(
                "An electrode needs a place, and a width and a contact impedance above 0; got "
                f"{self}."
            )


@dataclass(frozen=True, eq=False)
class Sensor:
    """A nominal sensor: all that a method may know of it.

    Attributes:
        outline: the rim [m].
        electrodes: in the order of their numbers.
        pattern: what one frame measures.
        background: conductivity of the untouched sensor [S/m].
        image_shape: (H, W) of the image grid, which fills the outline's bounding box.
        data_range: range of conductivity [S/m] that SSIM and PSNR are computed for; the background
            where none is given (NaN).
        conductivity_range: least and greatest conductivity as multiples of the background, a prior
            that all methods know alike: (0.05, 1) where a touch can only lower it.

    Raises:
        InputError: overlapping electrodes, or a pattern that names a missing electrode.
    """

    name: str
    outline: Outline
    electrodes: tuple[Electrode, ...]
    pattern: DrivePattern
    background: float = 1.0
    image_shape: tuple[int, int] = (80, 80)
    data_range: float = math.nan
    conductivity_range: tuple[float, float] = (0.05, 20.0)

    def __post_init__(self) -> None:
        if math.isnan(self.data_range):
            object.__setattr__(self, "data_range", self.background)
        low, high = self.conductivity_range
        positive = 0 < self.background < np.inf and 0 < self.data_range < np.inf
        if not (positive and 0 < low < 1 <= high < np.inf and min(self.image_shape) >= 2):
            raise InputError(
                f"Sensor {self.name!r} needs a background and a data range above 0 S/m, a "
                "conductivity range from above 0 to at least 1 times the background, and an image "
                f"of at least 2 x 2 pixels; got {self.background}, {self.data_range}, {low} to "
                f"{high}, and {self.image_shape}."
            )
        self._check_electrodes()
        if not self.mask.any():
            raise InputError(
                f"No pixel of sensor {self.name!r} has its middle inside the outline: use a finer "
                "image_shape."
            )
        table = self.pattern.table
        missing = table[(table < 0) | (table >= self.n_electrodes)]
        if missing.size:
            raise InputError(
                f"The drive pattern uses electrode {missing[0]}, but sensor {self.name!r} has "
                f"electrodes 0 to {self.n_electrodes - 1}."
            )

    def _check_electrodes(self) -> None:
        perimeter = self.outline.perimeter
        order = np.argsort([e.centre % perimeter for e in self.electrodes], kind="stable").tolist()
        for here, following in zip(order, order[1:] + order[:1], strict=True):
            first, second = self.electrodes[here], self.electrodes[following]
            spacing = (second.centre - first.centre) % perimeter if here != following else perimeter
            if (first.width + second.width) / 2 >= spacing - 1e-12 * perimeter:
                raise InputError(
                    f"Electrodes {here} and {following} of sensor {self.name!r} overlap: they are "
                    f"{1e3 * first.width:.4g} mm and {1e3 * second.width:.4g} mm wide and "
                    f"{1e3 * spacing:.4g} mm apart."
                )

    @cached_property
    def _content(self) -> str:
        return content_hash(self.describe())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sensor) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @property
    def n_electrodes(self) -> int:
        """E, the number of electrodes."""
        return len(self.electrodes)

    @property
    def n_measurements(self) -> int:
        """M, the number of values in a frame."""
        return self.pattern.n_measurements

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height (dx, dy) of a pixel [m]."""
        x0, y0, x1, y1 = self.outline.bounds
        return (x1 - x0) / self.image_shape[1], (y1 - y0) / self.image_shape[0]

    @cached_property
    def pixel_centres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x and y [m] of the pixel centres, each (H, W); row index grows with y."""
        x0, y0, _, _ = self.outline.bounds
        dx, dy = self.pixel_size
        height, width = self.image_shape
        x, y = np.meshgrid(x0 + dx * (np.arange(width) + 0.5), y0 + dy * (np.arange(height) + 0.5))
        return x, y

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """(H, W): the pixels whose centre lies inside the outline."""
        return self.outline.contains(*self.pixel_centres)

    def check_place(self, x_m: float, y_m: float) -> None:
        """Refuse a place (x, y) [m] off the sensor.

        Raises:
            InputError: it lies outside the outline; the sentence says how far the sensor reaches.
        """
        if not self.outline.reaches(x_m, y_m):
            x0, y0, x1, y1 = (1e3 * bound for bound in self.outline.bounds)
            raise InputError(
                f"({1e3 * x_m:.6g}, {1e3 * y_m:.6g}) mm is outside the sensor, which reaches from "
                f"({x0:.4g}, {y0:.4g}) to ({x1:.4g}, {y1:.4g}) mm."
            )

    def refined(self, factor: int) -> "Sensor":
        """The same sensor on an image grid, and so a mesh, `factor` times finer."""
        height, width = self.image_shape
        return replace(self, image_shape=(height * factor, width * factor))

    def describe(self) -> dict[str, object]:
        """All declared parameters as plain values, for hashing and printing."""
        return {
            "outline": self.outline.describe(),
            "electrodes": [[e.centre, e.width, e.contact_impedance] for e in self.electrodes],
            "pattern": self.pattern.describe(),
            "background": self.background,
            "image_shape": list(self.image_shape),
            "data_range": self.data_range,
            "conductivity_range": list(self.conductivity_range),
        }


def even_electrodes(
    outline: Outline,
    count: int,
    width: float,
    contact_impedance: float,
    *,
    start: float = 0.0,
    clockwise: bool = False,
) -> tuple[Electrode, ...]:
    """`count` equal electrodes evenly along the rim, the first centred at `start` [m]."""
    step = outline.perimeter / count * (-1 if clockwise else 1)
    return tuple(
        Electrode((start + step * k) % outline.perimeter, width, contact_impedance)
        for k in range(count)
    )


SensorBuilder = Callable[[], Sensor]


def foam16() -> Sensor:
    """The default sensor: a 0.1 m square of conductive foam with 16 electrodes, offset 3.

    Electrodes are 10 mm wide, four a side, centred at 12.5, 37.5, 62.5 and 87.5 mm, numbered
    counter-clockwise from the lower-left corner; contact impedance 1e-3 Ohm*m2, background 1 S/m,
    which a touch can only lower.
    """
    outline = rectangle(0.1, 0.1)
    electrodes = even_electrodes(outline, 16, 0.01, 1e-3, start=0.0125)
    return Sensor(
        "foam16", outline, electrodes, offset_pattern(16, 3), conductivity_range=(0.05, 1.0)
    )
