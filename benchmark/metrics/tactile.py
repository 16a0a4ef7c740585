"""Distance of the contacts in estimates from the true ones, and their overlap.

`eitbench.scenarios.phantoms.contacts` finds the contacts.
"""

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
    """Rows of `true` and `found` places that belong together, as in `distances`."""
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


def edges_and_artefacts(
    contacts: Contacts, truth: Array, estimate: Array, sensor: Sensor
) -> tuple[Array, Array]:
    """Sharpness at the edges of true contacts, and contrast that lies away from them.

    The zone of an edge reaches `EDGE_ZONE` of the sensor's diameter to both of its sides.

    Args:
        contacts: the true contacts.
        truth: (n, H, W) true contrast [S/m].
        estimate: (n, H, W) contrast of the estimate [S/m].

    Returns:
        The mean step of the estimate from the outer to the inner half of the zones, over that of
        the truth (n,); and the norm of its contrast outside contacts and zones, over the norm of
        the true contrast (n,). NaN where there is no true contact, or no pixel lies within
        `EDGE_ZONE` outside one (coarse images).
    """
    pixel = _pixel(sensor)
    reach = EDGE_ZONE * diameter(sensor)
    edge, artefacts = np.full(len(truth), np.nan), np.full(len(truth), np.nan)
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
        step, whole = (
            (sign * image[n][window])[inner].mean() - (sign * image[n][window])[outer].mean()
            for image in (estimate, truth)
        )
        edge[n] = step / whole
        far = sensor.mask.copy()
        far[window] &= outside > reach
        artefacts[n] = np.linalg.norm(estimate[n][far]) / np.linalg.norm(truth[n][sensor.mask])
    return edge, artefacts


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
    height, width = _pixel(sensor)
    pressure = FOAM.pressure(images[:, sensor.mask] / sensor.background)
    return np.asarray(height * width * pressure.sum(axis=1))


def _pixel(sensor: Sensor) -> tuple[float, float]:
    """Height and width of a pixel [m]."""
    height, width = sensor.image_shape
    x0, y0, x1, y1 = sensor.outline.bounds
    return (y1 - y0) / height, (x1 - x0) / width
