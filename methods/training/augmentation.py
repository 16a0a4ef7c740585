"""More training frames than were simulated: symmetries, new noise, the untouched sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.scenarios.imperfections.noise import MIXTURE_SHARE, MIXTURE_SNR_DB
from eitbench.scenarios.sensors.symmetry import motions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.problem import Problem
    from eitbench.scenarios.arrays import Array
    from eitbench.scenarios.imperfections.noise import Noise
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


def noise_estimates(
    problem: Problem, references: Array, gain_power: float
) -> tuple[Tensor, Tensor | None]:
    """What the noise of frames with `references` (n, M) goes through, see `Problem.estimates`.

    Returns:
        Number of each frame's matrix (n,), and the matrices (U, M, M); None where they change
        nothing.
    """
    units, matrices = problem.estimates(references, gain_power)
    changed = torch.from_numpy(matrices) if len(matrices) > 1 else None
    return torch.from_numpy(units), changed


def symmetries(sensor: Sensor, jacobian: Tensor) -> list[Symmetry]:
    """All symmetries of a sensor with the `jacobian` (M, H, W); the first changes nothing."""
    return [
        Symmetry(m.turns, m.mirrored, torch.from_numpy(m.order), torch.from_numpy(m.sign))
        for m in motions(sensor, jacobian.double().numpy())
    ]


UNTOUCHED = 1 / 64
"""Share of the training frames that are untouched: most frames of a skin in use are."""


@dataclass(frozen=True)
class Augmentation:
    """Random changes of a batch of simulated samples, drawn anew each time.

    Attributes:
        noise: that the scenario declares for its training split, of the frame and of its reference
            frame. It is drawn anew each time, so that no frame's noise can be learned by heart.
        motions: the sensor's symmetries.
        reference_rms: of the reference frame [V/A], which its noise is relative to.
        estimates: (U, M, M) what noise goes through before a network sees it, see
            `Problem.estimates`; by default nothing.
    """

    noise: Noise
    motions: Sequence[Symmetry]
    reference_rms: float
    estimates: Tensor | None = None

    def __call__(
        self, difference: Tensor, rms: Tensor, images: Tensor, unit: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Symmetry]:
        """Measured differences (n, M), images (n, H, W), and the symmetry that moved both.

        Args:
            difference: clean frames minus the clean reference frame (n, M) [V/A], as estimated.
            rms: of the clean frames (n,) [V/A], which noise is relative to.
            images: conductivity over background (n, H, W).
            unit: number of each frame's estimate (n,).
        """
        untouched = torch.rand(len(images), device=images.device) < UNTOUCHED
        difference = torch.where(untouched[:, None], 0.0, difference)
        images = torch.where(untouched[:, None, None], 1.0, images)
        deviation = self._level(rms) * (rms.square() + self.reference_rms**2).sqrt()
        noise = deviation[:, None] * torch.randn_like(difference)
        if self.estimates is not None and unit is not None:
            matrices = self.estimates[unit.cpu()].to(noise)
            noise = torch.einsum("nij,nj->ni", matrices, noise)
        noisy = difference + noise
        motion = self.motions[int(torch.randint(len(self.motions), ()))]
        return motion.voltages(noisy), motion.images(images), motion

    def _level(self, rms: Tensor) -> Tensor:
        """Standard deviation of the noise (n,), relative to each frame's rms."""
        if self.noise == "clean":
            return torch.zeros_like(rms)
        if self.noise != "mixture":
            return torch.full_like(rms, 10 ** (-self.noise / 20))
        low, high = MIXTURE_SNR_DB
        level = 10 ** (-(low + (high - low) * torch.rand_like(rms)) / 20)
        return torch.where(torch.rand_like(rms) < MIXTURE_SHARE, level, 0.0)
