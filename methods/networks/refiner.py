"""Corrects a first image by others that say where it may be wrong."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from eitbench.methods.networks.image_network import PatchUNet


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
