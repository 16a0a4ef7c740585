"""What a tactile skin needs to know: how many contacts, where, how large and how strong.

One rule finds contacts in every image, true or reconstructed: the pixels whose |contrast| is at
least a quarter of the image's largest (the "quarter-amplitude set" of GREIT), joined with the
neighbours of the same sign that touch along a side or a corner, and no smaller than 0.1 % of the
sensor unless nothing larger is there. An image of constant contrast shows no contact.
"""

import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import label
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, pdist

from eitbench.benchmark.metrics import is_constant
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors import Sensor

Array = NDArray[np.float64]

AMPLITUDE_FRACTION = 0.25
"""Adler et al., Physiol. Meas. 30 (2009) S35, section 3.1: the quarter-amplitude set."""
SMALLEST_AREA_FRACTION = 1e-3
_WEISZFELD_STEPS = 30

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
        total = np.bincount(self.image, weights=self.strength, minlength=len(self.region))
        return total.astype(np.float64)

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


def locate(contrast: ArrayLike, sensor: Sensor) -> Array:
    """Where each image of `contrast` (n, H, W) [S/m] shows its only contact: (n, 2) [m].

    For a sensor known to be touched once, all that stands out belongs to that touch, in however
    many pieces it is drawn. The place is the centre of the |contrast| in excess of a quarter of the
    image's largest; taking the excess makes it change continuously with the image. NaN where the
    contrast is constant.

    Raises:
        InputError: a wrong shape, or values inside the sensor that are not finite.
    """
    _, magnitude, peak = _standing_out(contrast, sensor)
    weight = np.maximum(magnitude - AMPLITUDE_FRACTION * peak[:, None, None], 0.0)
    weight[peak == 0] = 0.0
    total = weight.sum(axis=(1, 2))
    place = np.stack([np.tensordot(weight, c, axes=2) for c in sensor.pixel_centres], axis=-1)
    place[total == 0] = np.nan
    return np.asarray(place / np.where(total > 0, total, 1.0)[:, None])


def _standing_out(contrast: ArrayLike, sensor: Sensor) -> tuple[Array, Array, Array]:
    """Contrast and |contrast| (n, H, W), 0 outside the sensor, and its peak (n,), 0 if constant."""
    values = np.where(sensor.mask, np.asarray(contrast, dtype=np.float64), 0.0)
    if values.ndim != 3:
        raise InputError(f"Contrast must have shape (n, H, W), got {np.shape(contrast)}.")
    if not np.isfinite(values).all():
        raise InputError("Contrast must be finite inside the sensor: leave such frames out.")
    magnitude = np.abs(values)
    peak = magnitude.max(axis=(1, 2), initial=0.0)
    if len(values):
        peak[is_constant(values, sensor.mask)] = 0.0
    return values, magnitude, peak


def diameter(sensor: Sensor) -> float:
    """Largest distance between two points of the sensor [m]: the error of finding nothing."""
    outline = sensor.outline
    around = np.linspace(0.0, outline.perimeter, 256, endpoint=False)
    return float(pdist(outline.point(np.concatenate([around, outline.corners]))).max())


def localisation(truth: Contacts, estimate: Contacts, sensor: Sensor) -> Array:
    """Mean distance of the true contacts from the contacts found for them (n,) [m].

    Of an image with k true contacts the k strongest found ones are assigned so that the distances
    add up to the least. A true contact left over is charged the distance to the nearest found
    contact, and the sensor's diameter where none was found. NaN where there is no true contact.
    """
    error = np.full(len(truth.region), np.nan)
    for n in np.unique(truth.image):
        true = truth.position[truth.of(n)]
        found = estimate.position[estimate.of(n)][: len(true)]
        if not len(found):
            error[n] = diameter(sensor)
            continue
        distance = cdist(true, found)
        charged = distance.min(axis=1)
        rows, columns = linear_sum_assignment(distance)
        charged[rows] = distance[rows, columns]
        error[n] = charged.mean()
    return error


def overlap(
    truth: NDArray[np.int8], estimate: NDArray[np.int8], signs: tuple[int, ...] = (-1, 1)
) -> Array:
    """Intersection over union (n,) of signed regions (n, H, W), for the given `signs`.

    A pixel counts as shared only if both signs agree. NaN where neither image has such a pixel.
    """
    t, p = np.isin(truth, signs), np.isin(estimate, signs)
    shared = np.count_nonzero(t & p & (truth == estimate), axis=(1, 2))
    union = np.count_nonzero(t | p, axis=(1, 2))
    result = np.full(len(truth), np.nan)
    np.divide(shared, union, out=result, where=union > 0)
    return result


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * turn @ x + shift in the plane.

    Attributes:
        scale: > 0.
        turn: (2, 2) rotation, or rotation with reflection.
        shift: (2,) [m].
    """

    scale: float
    turn: Array
    shift: Array

    def __call__(self, points: ArrayLike) -> Array:
        """Map `points` (n, 2) [m]."""
        return np.asarray(self.scale * np.asarray(points, float) @ self.turn.T + self.shift)

    def inverse(self, points: ArrayLike) -> Array:
        """Map `points` (n, 2) [m] back."""
        return np.asarray((np.asarray(points, float) - self.shift) @ self.turn / self.scale)

    def to_json(self) -> str:
        """As JSON that `from_json` reads, without loss."""
        return json.dumps([self.scale, self.turn.tolist(), self.shift.tolist()])

    @classmethod
    def from_json(cls, text: str) -> "Similarity":
        """What `to_json` wrote."""
        scale, turn, shift = json.loads(text)
        return cls(scale, np.array(turn), np.array(shift))


def fit_similarity(source: ArrayLike, target: ArrayLike) -> Similarity | None:
    """The similarity, with or without reflection, that maps `source` best onto `target`.

    It makes the sum of distances least over points (n, 2) [m], not that of their squares: a method
    that loses some contacts altogether keeps the registration of those it finds. Rows with NaN are
    left out. None where fewer than three points are left, or where they determine no similarity.

    Source: Umeyama, IEEE Trans. Pattern Anal. 13 (1991) 376, eqs. 40-43, without the constraint on
    the determinant, so that reflections are allowed; repeated with the points weighted by their
    inverse distances (Weiszfeld's iteration).
    """
    x, y = np.asarray(source, float), np.asarray(target, float)
    known = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    x, y = x[known], y[known]
    if len(x) < 3:
        return None
    weights = np.ones(len(x))
    # Points that lie this close count alike: a distance of zero must not weigh infinitely.
    close = 0.01 * float(np.sqrt(np.mean((y - y.mean(axis=0)) ** 2)))
    fitted = _weighted_similarity(x, y, weights)
    for _ in range(_WEISZFELD_STEPS):
        if fitted is None or close == 0:
            break
        weights = 1 / np.maximum(np.hypot(*(fitted(x) - y).T), close)
        fitted = _weighted_similarity(x, y, weights)
    return fitted


def _weighted_similarity(x: Array, y: Array, weights: Array) -> Similarity | None:
    w = (weights / weights.sum())[:, None]
    x_mean, y_mean = (w * x).sum(axis=0), (w * y).sum(axis=0)
    u, singular, vt = np.linalg.svd((w * (y - y_mean)).T @ (x - x_mean))
    # A second singular value of zero leaves open whether to reflect.
    if singular[1] <= 1e-12 * singular[0] or singular[0] == 0:
        return None
    turn = u @ vt
    scale = float(singular.sum() / (w * (x - x_mean) ** 2).sum())
    return Similarity(scale, turn, y_mean - scale * turn @ x_mean)
