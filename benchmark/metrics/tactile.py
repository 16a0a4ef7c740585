"""Distance of the contacts in estimates from the true ones, and their overlap.

`eitbench.scenarios.phantoms.contacts` finds the contacts.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, pdist

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.contacts import Contacts
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.sensors.sensor import Sensor

EDGE_ZONE = 0.03
"""Half the width of the zone around the edges of true contacts, over the sensor's diameter."""


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
        error[n] = distances(true, found).mean()
    return error


def distances(true: Array, found: Array) -> Array:
    """Distance (k,) of each of k `true` places (k, 2) from the one `found` (m, 2) for it, m > 0.

    They are assigned so that the distances add up to the least; a true place that is left over is
    charged the distance to the nearest found one.
    """
    distance = cdist(true, found)
    charged = distance.min(axis=1)
    rows, columns = linear_sum_assignment(distance)
    charged[rows] = distance[rows, columns]
    return np.asarray(charged)


def matched(true: Array, found: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows (k,) of `true` (n, 2) and `found` (m, 2) places that belong together, k = min(n, m)."""
    rows, columns = linear_sum_assignment(cdist(true, found))
    return rows, columns


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


class EdgeZone(NamedTuple):
    """Pixels about the edges of the true contacts of one image, by their place in the flat image.

    Attributes:
        inner, outer: those within a distance of an edge, on its inner and on its outer side.
        inner_sign, outer_sign: of the contacts that these belong to.
        near: all of contacts and within the distance of one.
        step: mean step of the true contrast from `outer` to `inner` [S/m].
        norm: of the true contrast [S/m].
    """

    inner: NDArray[np.int32]
    outer: NDArray[np.int32]
    inner_sign: NDArray[np.int8]
    outer_sign: NDArray[np.int8]
    near: NDArray[np.int32]
    step: float
    norm: float


def edge_zones(contacts: Contacts, truth: Array, sensor: Sensor) -> list[EdgeZone | None]:
    """Zones around the edges of true contacts, one for each image.

    They reach `EDGE_ZONE` of the sensor's diameter to both sides of an edge.

    Args:
        contacts: the true contacts.
        truth: (n, H, W) true contrast [S/m].

    Returns:
        None where there is no true contact, or no pixel lies within `EDGE_ZONE` outside one
        (coarse images).
    """
    pixel = sensor.pixel_size[::-1]
    reach = EDGE_ZONE * diameter(sensor)
    number = np.arange(sensor.mask.size, dtype=np.int32).reshape(sensor.mask.shape)
    zones: list[EdgeZone | None] = [None] * len(truth)
    for n in np.unique(contacts.image):
        window = _window(contacts.region[n], reach, pixel)
        region, mask = contacts.region[n][window], sensor.mask[window]
        contact = region != 0
        outside, nearest = distance_transform_edt(~contact, pixel, return_indices=True)
        inside = distance_transform_edt(contact, pixel)
        sign = region[tuple(nearest)]  # of the contact that a pixel belongs to
        inner = contact & (inside <= reach) & mask
        outer = ~contact & (outside <= reach) & mask
        if not outer.any():
            continue
        inwards, outwards, near = (number[window][of] for of in (inner, outer, outside <= reach))
        signs = sign[inner], sign[outer]
        step = _step(truth[n].ravel(), inwards, outwards, *signs)
        norm = float(np.linalg.norm(truth[n][sensor.mask]))
        zones[n] = EdgeZone(inwards, outwards, *signs, near, step, norm)
    return zones


def edges_and_artefacts(
    zones: Sequence[EdgeZone | None], estimate: Array, sensor: Sensor
) -> tuple[Array, Array]:
    """Sharpness at the edges of true contacts, and contrast that lies away from them.

    Args:
        zones: of the n images.
        estimate: (n, H, W) contrast of the estimate [S/m].

    Returns:
        The mean step of the estimate from the outer to the inner half of the zones, over that of
        the truth (n,); and the norm of its contrast outside contacts and zones, over the norm of
        the true contrast (n,). NaN where there is no zone.
    """
    edge, artefacts = np.full(len(zones), np.nan), np.full(len(zones), np.nan)
    for n, zone in enumerate(zones):
        if zone is not None:
            image, far = estimate[n].ravel(), sensor.mask.flatten()
            far[zone.near] = False
            edge[n] = _step(image, *zone[:4]) / zone.step
            artefacts[n] = np.linalg.norm(image[far]) / zone.norm
    return edge, artefacts


def _step(
    image: Array,
    inner: NDArray[np.int32],
    outer: NDArray[np.int32],
    inner_sign: NDArray[np.int8],
    outer_sign: NDArray[np.int8],
) -> float:
    """Mean step of a flat image from `outer` to `inner`; arguments as of `EdgeZone`."""
    return float((inner_sign * image[inner]).mean() - (outer_sign * image[outer]).mean())


def _window(
    region: NDArray[np.int8], reach: float, pixel: tuple[float, float]
) -> tuple[slice, ...]:
    """The part of an image that holds its contacts with all pixels within `reach` [m] of them."""
    window = []
    for axis, size in enumerate(pixel):
        there = np.flatnonzero(region.any(axis=1 - axis))
        more = int(reach / size) + 1
        window.append(slice(max(0, there[0] - more), there[-1] + more + 1))
    return tuple(window)


def force(images: NDArray[np.floating], sensor: Sensor) -> Array:
    """Force (n,) [N] of what presses, from images (n, H, W) [S/m], by the law of the foam.

    It is the integral of `FoamLayer.pressure` over the sensor.
    """
    width, height = sensor.pixel_size
    pressure = FOAM.pressure(images[:, sensor.mask] / sensor.background)
    return np.asarray(height * width * pressure.sum(axis=1))
