"""A sensor in pyEIT's terms: its own mesh with point electrodes, and our drive pattern.

pyEIT has no complete electrode model: a current enters at one node, and the potential of that node
is what an electrode measures. Coordinates are centred and scaled so that the sensor's longer half
side is 1, as pyEIT's mesh generator expects; potentials in two dimensions do not depend on scale.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon

if TYPE_CHECKING:
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    from eitbench.scenarios.sensors.patterns import DrivePattern
    from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]

# pyEIT's default distance between nodes, of half the sensor's longer side.
NODE_DISTANCE = 0.1
SAME_POINT = 1e-6


def scaled(outline: Outline, points: Array) -> Array:
    """`points` (..., 2) [m] centred on the outline's bounding box; its longer half side is 1."""
    x0, y0, x1, y1 = outline.bounds
    return np.asarray((points - np.array([x0 + x1, y0 + y1]) / 2) * (2 / max(x1 - x0, y1 - y0)))


def signed_distance(outline: Outline, points: Array) -> Array:
    """Distance (p,) from scaled `points` (p, 2) to the rim, negative inside.

    Raises:
        InputError: an outline that is neither a disc nor a polygon.
    """
    if isinstance(outline, Disc):
        return np.asarray(np.hypot(points[:, 0], points[:, 1]) - 1)
    if not isinstance(outline, Polygon):
        raise InputError("pyEIT's meshes are made of discs and polygons only.")
    corners = scaled(outline, np.array(outline.vertices))
    sides = np.roll(corners, -1, axis=0) - corners
    offset = points[:, None] - corners
    along = np.clip(np.sum(offset * sides, axis=-1) / np.sum(sides**2, axis=-1), 0, 1)
    distance = np.linalg.norm(offset - along[..., None] * sides, axis=-1).min(axis=1)
    unit = Polygon(tuple((float(x), float(y)) for x, y in corners))
    return np.asarray(np.where(unit.contains(*points.T), -distance, distance))


@lru_cache(maxsize=8)
def pyeit_mesh(sensor: Sensor) -> PyEITMesh:
    """pyEIT's mesh of the sensor at 1 S/m; electrode k is node k, at the electrode's centre."""
    from pyeit.mesh import create

    outline = sensor.outline
    fixed = scaled(outline, outline.point(np.array([e.centre for e in sensor.electrodes])))
    for corner in scaled(outline, outline.point(outline.corners)):
        if np.linalg.norm(fixed - corner, axis=1).min() > SAME_POINT:
            fixed = np.vstack([fixed, corner])
    x0, y0, x1, y1 = outline.bounds
    box = scaled(outline, np.array([[x0, y0], [x1, y1]]))
    return create(
        n_el=sensor.n_electrodes,
        fd=lambda points: signed_distance(outline, points),
        h0=NODE_DISTANCE,
        p_fix=fixed,
        bbox=box,
    )


def pyeit_protocol(pattern: DrivePattern) -> PyEITProtocol:
    """The drive pattern, measurement by measurement, with our signs and in our order.

    pyEIT wants equally many measurements of every excitation. Runs of rows with the same drive are
    cut into equal parts of the largest size that fits all: a whole run where all are as long.
    """
    from pyeit.eit.protocol import PyEITProtocol

    table = pattern.table
    changes = (np.diff(table[:, :2], axis=0) != 0).any(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], changes, [True]]))
    size = int(np.gcd.reduce(np.diff(starts)))
    return PyEITProtocol(
        ex_mat=np.array(table[::size, :2]),
        meas_mat=np.array(table[:, 2:]).reshape(-1, size, 2),
        keep_ba=np.ones(len(table), dtype=bool),
    )
