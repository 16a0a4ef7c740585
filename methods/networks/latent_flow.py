"""A distribution of images given a frame: a conditional flow over the principal components."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

COMPONENTS, MEASURED = 96, 64
"""Principal components of images, and of frames; fewer where there are not as many pixels or
measurements."""
COUPLINGS, WIDTH = 8, 192
"""Steps of the flow, and units of the layers in each."""
LARGEST = 2.0
"""Of the logarithm of a factor in a step, so that no step can run away."""
LEAST = 1e-4
"""Spread of a component, relative to the largest: frames repeat each other by reciprocity."""


class LatentFlow(nn.Module):
    """p(image | frame): images by their components z, z by a chain of conditional affine couplings.

    Each step scales and shifts half of z by what the other half and the frame say (real NVP: Dinh,
    Sohl-Dickstein and Bengio, ICLR 2017), so that the density is known exactly and draws are made
    in one pass. What lies outside the components is not drawn.

    Attributes:
        components: (K, P) principal components of contrasts over the background, in units of their
            standard deviations; `mean` (P,).
        seen: (M, C) what frames [V/A] are multiplied with.
    """

    components: Tensor
    mean: Tensor
    seen: Tensor
    halves: Tensor

    def __init__(self, n_measurements: int, image_shape: tuple[int, int]) -> None:
        super().__init__()
        self.image_shape = image_shape
        pixels = math.prod(image_shape)
        count, measured = min(COMPONENTS, pixels), min(MEASURED, n_measurements)
        self.register_buffer("components", torch.zeros(count, pixels))
        self.register_buffer("mean", torch.zeros(pixels))
        self.register_buffer("seen", torch.zeros(n_measurements, measured))
        # Strong and weak components lie in both halves; which is changed alternates.
        number = torch.arange(count)
        order = [number % 2 == 0, number % 2 != 0, number % 4 < 2, number % 4 >= 2]
        halves = torch.stack([order[k % len(order)] for k in range(COUPLINGS)])
        self.register_buffer("halves", halves, persistent=False)
        self.context = nn.Sequential(
            nn.Linear(measured, 2 * WIDTH), nn.GELU(), nn.Linear(2 * WIDTH, 2 * WIDTH), nn.GELU(),
            nn.Linear(2 * WIDTH, WIDTH), nn.GELU(),
        )  # fmt: skip
        self.couplings = nn.ModuleList(_Coupling(count) for _ in range(COUPLINGS))

    def start_from(self, images: Tensor, differences: Tensor) -> None:
        """Take components from contrasts (n, H, W) over the background and frames (n, M) [V/A]."""
        flat = images.flatten(1)
        self.mean.copy_(flat.mean(0))
        _, spread, axes = torch.svd_lowrank(flat - self.mean, len(self.components), niter=6)
        self.components.copy_((axes * _floored(spread) / math.sqrt(len(flat))).T)
        _, spread, axes = torch.svd_lowrank(differences, self.seen.shape[1], niter=6)
        self.seen.copy_(axes / (_floored(spread) / math.sqrt(len(differences))))

    def encoded(self, images: Tensor) -> Tensor:
        """Components (n, K) of contrasts (n, H, W) over the background."""
        squares = self.components.square().sum(1)
        return (images.flatten(1) - self.mean) @ self.components.T / squares

    def decoded(self, z: Tensor) -> Tensor:
        """Contrasts (n, H, W) over the background of components (n, K)."""
        return (self.mean + z @ self.components).reshape(*z.shape[:-1], *self.image_shape)

    def log_density(self, z: Tensor, difference: Tensor) -> Tensor:
        """Logarithm of the density (n,) at components (n, K), given frames (n, M) [V/A]."""
        context = self.context(difference @ self.seen)
        volume = torch.zeros(len(z), device=z.device)
        for half, coupling in zip(self.halves, self.couplings, strict=True):
            log_factor, shift = coupling(torch.where(half, z, 0.0), context)
            z = torch.where(half, z, (z - shift) * (-log_factor).exp())
            volume = volume - torch.where(half, 0.0, log_factor).sum(1)
        constant = len(self.components) / 2 * math.log(2 * math.pi)
        density: Tensor = volume - z.square().sum(1) / 2 - constant
        return density

    def draws(self, normal: Tensor, difference: Tensor) -> Tensor:
        """Contrasts (n, D, H, W) from normal numbers (D, K), given frames (n, M) [V/A]."""
        count, frames = len(normal), len(difference)
        context = self.context(difference @ self.seen).repeat_interleave(count, 0)
        z = normal.repeat(frames, 1)
        for half, coupling in reversed(list(zip(self.halves, self.couplings, strict=True))):
            log_factor, shift = coupling(torch.where(half, z, 0.0), context)
            z = torch.where(half, z, z * log_factor.exp() + shift)
        return self.decoded(z.reshape(frames, count, len(self.components)))


def _floored(spread: Tensor) -> Tensor:
    """Singular values, of which those of rounding alone must not be divided by."""
    return spread.clamp(min=LEAST * float(spread.max()))


class _Coupling(nn.Module):
    """Logarithms of factors, and shifts (n, K) each, from half of z and the context; 0 at first."""

    def __init__(self, components: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(components + WIDTH, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU(),
        )  # fmt: skip
        self.leave = nn.Linear(WIDTH, 2 * components)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, z: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        found = self.leave(self.layers(torch.cat([z, context], dim=1)))
        log_factor, shift = found.chunk(2, dim=1)
        return LARGEST * torch.tanh(log_factor / LARGEST), shift
