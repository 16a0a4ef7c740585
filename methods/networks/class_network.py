"""A U-Net that says which class each pixel of linear images belongs to."""

import torch
from torch import Tensor, nn

from eitbench.methods.networks.image_network import FEWER_CHANNELS, PatchUNet
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
