"""A U-Net that says which class each pixel of linear images belongs to."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from eitbench.methods.networks.image_network import FEWER_CHANNELS, PatchUNet

if TYPE_CHECKING:
    from eitbench.methods.learned.tank_unet import LinearImages
    from eitbench.scenarios.arrays import Mask


class ClassNetwork(nn.Module):
    """Expected class (n, H, W), from -1 to 1, of pixels by linear images (n, C, H, W).

    Attributes:
        scale: (C,) what each image is divided by.
    """

    mask: Tensor
    scale: Tensor

    def __init__(self, mask: Mask, count: int) -> None:
        """`mask` (H, W) marks the sensor's pixels; `count` is C."""
        super().__init__()
        self.register_buffer("mask", torch.from_numpy(mask.copy()), persistent=False)
        self.register_buffer("scale", torch.ones(count))
        self.unet = PatchUNet(count, 0, (mask.shape[0], mask.shape[1]), FEWER_CHANNELS)

    def forward(self, images: Tensor) -> Tensor:
        """Expected class (n, H, W); 0 outside the sensor."""
        change: Tensor = self.unet(images / self.scale[:, None, None]).float()
        return change * self.mask

    def images_of(self, linear: LinearImages) -> Callable[[Tensor], Tensor]:
        """Return the map from differences (n, M) [V/A] to images (n, C, H, W)."""
        count, inside = linear.matrix.shape[1] + 1, self.mask
        combinations = torch.from_numpy(linear.combinations).float()
        matrix = torch.from_numpy(linear.matrix).float().flatten(1)
        seen = torch.from_numpy(linear.seen).float()

        def images(difference: Tensor) -> Tensor:
            shown = (difference @ combinations @ matrix).view(len(difference), count - 1, -1)
            shown = torch.cat([shown, seen.expand(len(shown), 1, -1)], dim=1)
            full = torch.zeros(len(shown), count, *inside.shape)
            full[:, :, inside] = shown
            return full

        return images
