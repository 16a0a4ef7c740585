"""Contacts in an image of conductivity: their number, places, sizes and strengths.

One rule finds contacts in every image, true or reconstructed: the pixels whose |contrast| is at
least a quarter of the image's largest (the "quarter-amplitude set" of GREIT), joined with the
neighbours of the same sign that touch along a side or a corner, and no smaller than 0.1 % of the
sensor unless nothing larger is there. An image of constant contrast shows no contact.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label

from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor

AMPLITUDE_FRACTION = 0.25
"""Adler et al., Physiol. Meas. 30 (2009) S35, section 3.1: the quarter-amplitude set."""
SMALLEST_AREA_FRACTION = 1e-3

# Neighbours within an image along sides and corners; never from one image to the next.
_NEIGHBOURS = np.zeros((3, 3, 3), dtype=bool)
_NEIGHBOURS[1] = True


@dataclass(frozen=True, eq=False)
class Contacts:
    """The contacts of n images, k in all, ordered by image and by falling strength.

    Attributes:
        image: (k,) number of the image a contact is in.
        position: (k, 2) x and y [m] of the centroid, weighted with |contrast|.
        strength: (k,) |contrast| integrated over the contact [S/m * m^2].
        area: (k,) [m^2].
        region: (n, H, W) sign of the contrast on the pixels of contacts, 0 elsewhere.
    """

    image: NDArray[np.int64]
    position: Array
    strength: Array
    area: Array
    region: NDArray[np.int8]

    def of(self, image: int) -> slice:
        """The contacts of one image, the strongest first."""
        first, last = np.searchsorted(self.image, [image, image + 1])
        return slice(int(first), int(last))

    @property
    def count(self) -> NDArray[np.int64]:
        """Number of contacts of every image (n,)."""
        return np.bincount(self.image, minlength=len(self.region))

    @property
    def total_strength(self) -> Array:
        """Strength of all contacts of every image (n,) [S/m * m^2]."""
        return _totals(self.image, self.strength, len(self.region))

    @property
    def total_area(self) -> Array:
        """Area of all contacts of every image (n,) [m^2]."""
        return _totals(self.image, self.area, len(self.region))

    def strongest(self, values: Array, missing: float) -> Array:
        """The `values` (k, ...) of each image's strongest contact; `missing` where it has none."""
        chosen = np.full((len(self.region), *values.shape[1:]), missing)
        images, first = np.unique(self.image, return_index=True)
        chosen[images] = values[first]
        return chosen


def contacts(contrast: ArrayLike, sensor: Sensor) -> Contacts:
    """Find the contacts in images of `contrast` (n, H, W) [S/m].

    Raises:
        InputError: a wrong shape, or values inside the sensor that are not finite.
    """
    values, magnitude, peak = _standing_out(contrast, sensor)
    high = (magnitude >= AMPLITUDE_FRACTION * peak[:, None, None]) & (peak > 0)[:, None, None]
    high &= magnitude > 0
    labels, n_positive = label(high & (values > 0), _NEIGHBOURS)
    negative, n_negative = label(high & (values < 0), _NEIGHBOURS)
    labels += np.where(negative > 0, negative + n_positive, 0)
    k = n_positive + n_negative

    place = np.nonzero(labels)
    number, weight = labels[place] - 1, magnitude[place]
    image = np.zeros(k, dtype=np.int64)
    image[number] = place[0]
    x, y = (axis[place[1:]] for axis in sensor.pixel_centres)
    total, x, y, pixels = (
        _totals(number, w, k) for w in (weight, weight * x, weight * y, np.ones(len(number)))
    )
    keep = _large_enough(pixels, image, sensor)
    order = np.lexsort((-total, image))
    order = order[keep[order]]
    pixel_area = sensor.pixel_size[0] * sensor.pixel_size[1]
    return Contacts(
        image=image[order],
        position=np.stack([x, y], axis=1)[order] / total[order, None],
        strength=total[order] * pixel_area,
        area=pixels[order] * pixel_area,
        region=(np.sign(values) * np.append(False, keep)[labels]).astype(np.int8),
    )


def _totals(number: NDArray[np.integer], weights: Array, count: int) -> Array:
    """The weights added up by number: (count,)."""
    return np.bincount(number, weights=weights, minlength=count).astype(np.float64)


def _large_enough(pixels: Array, image: NDArray[np.int64], sensor: Sensor) -> NDArray[np.bool_]:
    large = pixels >= SMALLEST_AREA_FRACTION * np.count_nonzero(sensor.mask)
    return np.asarray(large | ~np.isin(image, image[large]))


def locate(contrast: ArrayLike, sensor: Sensor, background: float = 0.0) -> Array:
    """Place (n, 2) [m] of the only contact in each image of `contrast` (n, H, W) [S/m].

    For a sensor known to be touched once, all that stands out belongs to that touch, in however
    many parts it is drawn. The place is the centre of the |contrast| in excess of a quarter of the
    image's largest; taking the excess makes it change continuously with the image. NaN where the
    contrast is constant. The `background` [S/m] is taken off first: of images of conductivity it is
    the sensor's. Errors as those of `contacts`.
    """
    values = np.asarray(contrast)
    if values.dtype != np.float32:  # which is read as it is: draws are many
        values = values.astype(np.float64, copy=False)
    _require_images(values, sensor)
    place = np.empty((len(values), 2))
    if not _fill_places(place, values, background, sensor.mask, *sensor.pixel_centres):
        _require_finite(values, sensor)
    return place


@compiled
def _fill_places(
    place: Array, images: NDArray[np.floating], background: float, mask: Mask, x: Array, y: Array
) -> bool:
    """Fill in the `place` (n, 2) of each image; False where one is not finite inside the mask.

    Pixels have their centres at `x` and `y` (H, W). All is kept by columns, which the processor
    works on side by side.
    """
    height, width = mask.shape
    least, most = np.empty(width, images.dtype), np.empty(width, images.dtype)
    unknown = np.zeros(width, np.int32)
    weight, along, across = np.empty(width), np.empty(width), np.empty(width)
    for n in range(len(images)):
        least[:], most[:] = np.inf, -np.inf
        for i in range(height):
            for j in range(width):
                value, inside = images[n, i, j], mask[i, j]
                unknown[j] += np.int32(inside and not abs(value) < np.inf)
                least[j] = value if inside and value < least[j] else least[j]
                most[j] = value if inside and value > most[j] else most[j]
        low, high = np.float64(least.min()) - background, np.float64(most.max()) - background
        quarter = AMPLITUDE_FRACTION * max(abs(low), abs(high)) if low < high else np.inf
        weight[:], along[:], across[:] = 0.0, 0.0, 0.0
        for i in range(height):
            for j in range(width):
                over = abs(np.float64(images[n, i, j]) - background) - quarter
                excess = over if mask[i, j] and over > 0.0 else 0.0
                weight[j] += excess
                along[j] += excess * x[i, j]
                across[j] += excess * y[i, j]
        total = weight.sum()
        place[n, 0] = along.sum() / total if total > 0.0 else np.nan
        place[n, 1] = across.sum() / total if total > 0.0 else np.nan
    return bool(unknown.sum() == 0)


def _standing_out(contrast: ArrayLike, sensor: Sensor) -> tuple[Array, Array, Array]:
    """Contrast and |contrast| (n, H, W), 0 outside the sensor, and its peak (n,), 0 if constant."""
    given = np.asarray(contrast, dtype=np.float64)
    _require_images(given, sensor)
    _require_finite(given, sensor)
    values = np.where(sensor.mask, given, 0.0)
    magnitude = np.abs(values)
    peak = magnitude.max(axis=(1, 2), initial=0.0)
    if len(values):
        peak[is_constant(values, sensor.mask)] = 0.0
    return values, magnitude, peak


def _require_images(contrast: NDArray[np.floating], sensor: Sensor) -> None:
    if contrast.ndim != 3 or contrast.shape[1:] != sensor.mask.shape:
        height, width = sensor.mask.shape
        raise InputError(f"Contrast must have shape (n, {height}, {width}), got {contrast.shape}.")


def _require_finite(contrast: NDArray[np.floating], sensor: Sensor) -> None:
    known = np.isfinite(contrast)
    if not known.all() and not known[:, sensor.mask].all():
        raise InputError("Contrast must be finite inside the sensor: leave such frames out.")


def is_constant(images: ArrayLike, mask: Mask | None = None) -> Mask:
    """True (n,) for `images` (n, H, W) that have one value on all pixels of the mask."""
    stack = np.asarray(images)
    inside = np.ones(stack.shape[1:], dtype=bool) if mask is None else np.asarray(mask)
    one = stack[(slice(None), *np.argwhere(inside)[0])]
    return np.asarray(((stack == one[:, None, None]) | ~inside).all(axis=(1, 2)))
