"""Symmetries of a sensor for tensors (see `eitbench.scenarios.sensors.symmetry`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.scenarios.sensors.symmetry import motions

if TYPE_CHECKING:
    from eitbench.scenarios.sensors.sensor import Sensor


@dataclass(frozen=True)
class Symmetry:
    """A `Motion` that moves tensors.

    Attributes:
        turns, mirrored: see `Motion`.
        order, sign: (M,) the moved frame is v[order] * sign.
    """

    turns: int
    mirrored: bool
    order: Tensor
    sign: Tensor

    def images(self, images: Tensor) -> Tensor:
        """Moved images (..., H, W)."""
        turned = torch.rot90(images, self.turns, (-2, -1))
        return turned.flip(-1) if self.mirrored else turned

    def voltages(self, voltages: Tensor) -> Tensor:
        """Moved frames (..., M)."""
        order, sign = self.order.to(voltages.device), self.sign.to(voltages)
        return voltages[..., order] * sign


def symmetries(sensor: Sensor, jacobian: Tensor) -> list[Symmetry]:
    """All symmetries of a sensor with the `jacobian` (M, H, W); the first changes nothing."""
    return [
        Symmetry(
            motion.turns,
            motion.mirrored,
            torch.from_numpy(motion.order),
            torch.from_numpy(motion.sign),
        )
        for motion in motions(sensor, jacobian.double().cpu().numpy())
    ]
