"""Networks on a first image: one corrects it by others, one says how far it may be wrong."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from eitbench.methods.networks.image_network import PatchUNet

LEAST = 1e-3
"""Least deviation, over the background, that a `SpreadNetwork` gives."""
SOFT = 0.03
"""Width of the bend of its last function; what is far below it learns no more."""


class Refiner(nn.Module):
    """Conductivity over background (n, H, W) from images (n, C, H, W), the first of them a guess.

    It begins as the identity on the guess. A share of every other image is added in full precision
    whatever the autocast, and the rest of the correction is a U-Net's.

    Attributes:
        scale: (C,) what each image is divided by for the U-Net.
        shares: (C - 1,) of the other images, in units of their scale.
    """

    scale: Tensor
    mask: Tensor

    def __init__(self, mask: Tensor, count: int) -> None:
        """`mask` (H, W) marks the sensor's pixels; `count` is C."""
        super().__init__()
        self.register_buffer("mask", mask, persistent=False)
        self.register_buffer("scale", torch.ones(count))
        self.shares = nn.Parameter(torch.zeros(count - 1))
        self.unet = PatchUNet(count, 0, (mask.shape[0], mask.shape[1]))

    def forward(self, images: Tensor) -> Tensor:
        """Conductivity over background (n, H, W); the guess outside the sensor."""
        guess = images[:, 0]
        scaled = torch.cat([guess[:, None] - 1, images[:, 1:]], dim=1) / self.scale[:, None, None]
        with torch.autocast(images.device.type, enabled=False):
            blended = torch.einsum("c,nchw->nhw", self.shares, scaled[:, 1:])
        change: Tensor = blended + self.unet(scaled).float()
        return guess + change * self.mask


class SpreadNetwork(nn.Module):
    """Standard deviation (n, H, W) of conductivity over background, from an image (n, 1, H, W).

    It begins with one for all pixels. The last function is a softplus in units of deviations: under
    an exponential or a sigmoid, most pixels being the untouched background, all of them vanished.

    Attributes:
        scale: (1,) what the image's contrast is divided by for the U-Net.
    """

    scale: Tensor

    def __init__(self, image_shape: tuple[int, int]) -> None:
        super().__init__()
        self.register_buffer("scale", torch.ones(1))
        self.unet = PatchUNet(1, 0, image_shape)

    def forward(self, images: Tensor) -> Tensor:
        """Deviations (n, H, W)."""
        found: Tensor = self.unet((images - 1) / self.scale).float()
        return LEAST + SOFT * functional.softplus(found / SOFT)
