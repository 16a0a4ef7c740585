"""Symmetries of a sensor: turns and mirrors of its image, and the frames that they lead to."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.sensors.sensor import Sensor

TOLERANCE = 1e-6
"""Greatest change of the Jacobian under a symmetry, relative to its largest entry."""


def asymmetry(reason: str) -> dict[str, str]:
    """Expected failures of a method that cannot keep the symmetry of a sensor, see `Method`."""
    return {"rotation_equivariance": reason, "mirror_equivariance": reason}


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of the sensor onto itself: a moved image has moved voltages.

    Attributes:
        turns: quarter turns clockwise, on the sensor.
        mirrored: whether x is reversed afterwards.
        order, sign: (M,) the moved frame is v[order] * sign.
    """

    turns: int
    mirrored: bool
    order: NDArray[np.int64]
    sign: Array

    def images(self, images: ArrayLike) -> Array:
        """Moved images (..., H, W)."""
        # Rows grow with y, so that turning the array counter-clockwise turns the sensor clockwise.
        turned = np.rot90(images, self.turns, (-2, -1))
        return np.ascontiguousarray(turned[..., ::-1] if self.mirrored else turned)

    def voltages(self, voltages: ArrayLike) -> Array:
        """Moved frames (..., M)."""
        return np.asarray(voltages)[..., self.order] * self.sign

    def images_back(self, images: ArrayLike) -> Array:
        """Images (..., H, W) of which `images` are the moved ones."""
        turned = np.asarray(images)[..., ::-1] if self.mirrored else np.asarray(images)
        return np.rot90(turned, -self.turns, (-2, -1))


def motions(sensor: Sensor, jacobian: Array) -> list[Motion]:
    """All symmetries of a sensor with the `jacobian` (M, H, W); the first changes nothing.

    Turning and mirroring electrodes shows how measurements would have to move; it is a symmetry if
    the Jacobian, moved so, stays what it is.
    """
    found = []
    for turns, mirrored in product(range(4), (False, True)):
        moved = _moved_measurements(sensor, turns, mirrored)
        if moved is None:
            continue
        candidate = Motion(turns, mirrored, *moved)
        image = candidate.images(jacobian)
        if image.shape != jacobian.shape:
            continue
        change = image[candidate.order] * candidate.sign[:, None, None] - jacobian
        if np.abs(change).max() <= TOLERANCE * np.abs(jacobian).max():
            found.append(candidate)
    return found


def mean_over(motions: Sequence[Motion], images: Images) -> Images:
    """Mean (n, H, W) of the images of n samples under every motion, moved back.

    What comes of it moves with the sensor exactly, whatever maps the moved samples to `images`: the
    motions are a group, so that the same images are averaged for a sample and for a moved one.

    Args:
        motions: all symmetries of a sensor.
        images: (len(motions) * n, H, W) of all samples under the first motion, then the second.
    """
    parts = np.split(images, len(motions))
    back = [motion.images_back(part) for motion, part in zip(motions, parts, strict=True)]
    return np.asarray(np.mean(back, axis=0))


def _moved_measurements(
    sensor: Sensor, turns: int, mirrored: bool
) -> tuple[NDArray[np.int64], Array] | None:
    """`order` and `sign` (M,) if electrodes and measurements could move so; else None."""
    x0, y0, x1, y1 = sensor.outline.bounds
    centres = sensor.outline.point([electrode.centre for electrode in sensor.electrodes])
    places = 2 * (centres - [x0, y0]) / [x1 - x0, y1 - y0] - 1
    moved = places
    for _ in range(turns):
        moved = moved[:, ::-1] * [1, -1]
    if mirrored:
        moved = moved * [-1, 1]
    electrodes = np.linalg.norm(moved[:, None] - places, axis=-1).argmin(axis=1)
    if len(set(electrodes.tolist())) < len(electrodes):
        return None
    return _matched(sensor.pattern.table, electrodes, sensor.pattern.magnitudes)


def _matched(
    table: NDArray[np.int64], electrodes: NDArray[np.int64], magnitudes: bool
) -> tuple[NDArray[np.int64], Array] | None:
    """Number of each measurement after its electrode e has become `electrodes[e]`."""
    known: dict[tuple[int, ...], tuple[int, int]] = {}
    # A pattern may drive both ways: a measurement stands for another only where that is not there.
    for drive_sign, sense_sign in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        for m, row in enumerate(table.tolist()):
            drive, sense = row[:2][::drive_sign], row[2:][::sense_sign]
            known.setdefault((*drive, *sense), (m, 1 if magnitudes else drive_sign * sense_sign))
    order = np.full(len(table), -1)
    sign = np.ones(len(table))
    for m, row in enumerate(electrodes[table].tolist()):
        if tuple(row) not in known:
            return None
        target, sign_there = known[tuple(row)]
        order[target], sign[target] = m, sign_there
    return None if (order < 0).any() else (order, sign)
