"""Turns and mirrors of the image under which a sensor is the same, to learn from more data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eitbench.scenarios.sensors import Sensor

TOLERANCE = 1e-6
"""How much the Jacobian may change, relative to its largest entry, under a symmetry."""


@dataclass(frozen=True)
class Symmetry:
    """A motion of the sensor onto itself: a moved image has moved voltages.

    Attributes:
        turns: quarter turns clockwise, on the sensor.
        mirrored: whether x is reversed afterwards.
        order, sign: (M,) the moved frame is v[order] * sign.
    """

    turns: int
    mirrored: bool
    order: Tensor
    sign: Tensor

    def images(self, images: Tensor) -> Tensor:
        """Moved images (..., H, W)."""
        # Rows grow with y, so that turning the array counter-clockwise turns the sensor clockwise.
        turned = torch.rot90(images, self.turns, (-2, -1))
        return turned.flip(-1) if self.mirrored else turned

    def voltages(self, voltages: Tensor) -> Tensor:
        """Moved frames (..., M)."""
        order, sign = self.order.to(voltages.device), self.sign.to(voltages)
        return voltages[..., order] * sign


def symmetries(sensor: Sensor, jacobian: Tensor) -> list[Symmetry]:
    """All symmetries of a sensor with the `jacobian` (M, H, W); the first changes nothing.

    Turning and mirroring electrodes shows how measurements would have to move; it is a symmetry if
    the Jacobian, moved so, stays what it is.
    """
    found = []
    for turns in range(4):
        for mirrored in (False, True):
            moved = _moved_measurements(sensor, turns, mirrored)
            if moved is None:
                continue
            candidate = Symmetry(turns, mirrored, *moved)
            image = candidate.images(jacobian)
            if image.shape != jacobian.shape:
                continue
            change = candidate.voltages(image.movedim(0, -1)).movedim(-1, 0) - jacobian
            if change.abs().max() <= TOLERANCE * jacobian.abs().max():
                found.append(candidate)
    return found


def _moved_measurements(sensor: Sensor, turns: int, mirrored: bool) -> tuple[Tensor, Tensor] | None:
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
) -> tuple[Tensor, Tensor] | None:
    """Which measurement each is after its electrode e has become `electrodes[e]`."""
    known: dict[tuple[int, ...], tuple[int, int]] = {}
    # A pattern may drive both ways: a measurement stands for another only where that is not there.
    for drive_sign, sense_sign in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        for m, row in enumerate(table.tolist()):
            drive, sense = row[:2][::drive_sign], row[2:][::sense_sign]
            known.setdefault((*drive, *sense), (m, 1 if magnitudes else drive_sign * sense_sign))
    order = torch.full((len(table),), -1)
    sign = torch.ones(len(table))
    for m, row in enumerate(electrodes[table].tolist()):
        if tuple(row) not in known:
            return None
        target, sign_there = known[tuple(row)]
        order[target], sign[target] = m, sign_there
    return None if (order < 0).any() else (order, sign)
