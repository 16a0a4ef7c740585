"""The physical loss: the error of the voltages that reconstructed images predict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from eitbench.methods.operator import Operator
    from eitbench.methods.training.symmetry import Symmetry


class PhysicalLoss(nn.Module):
    """Mean over frames and measurements of ((F(sigma_p) - V) / s)^2.

    F is a forward operator, V the frame that the network saw, in model units, and s (M,) the
    standard deviation of each measurement over the training frames, by which the published work
    standardises voltages too. sigma_p is kept within the sensor's range of conductivity, for
    outside it F need not exist; there its gradient is 0.
    """

    reference: Tensor
    std: Tensor

    def __init__(self, operator: Operator, reference: Tensor, std: Tensor) -> None:
        """`reference` frame (M,) and `std` (M,) are in model units [V/A]."""
        super().__init__()
        self.operator = operator
        sensor = operator.sensor
        self.background, self.range = sensor.background, sensor.conductivity_range
        self.register_buffer("reference", reference, persistent=False)
        self.register_buffer("std", std, persistent=False)

    def forward(self, relative: Tensor, difference: Tensor, motion: Symmetry | None) -> Tensor:
        """Loss () of images `relative` to the background (n, H, W).

        `difference` (n, M) [V/A] is what the network saw, moved by `motion` if that is given.
        """
        sigma = relative.clamp(*self.range) * self.background
        reference = self.reference if motion is None else motion.voltages(self.reference)
        with torch.autocast(sigma.device.type, enabled=False):
            error = (self.operator.voltages(sigma) - reference - difference) / self.std
        return error.square().mean()
