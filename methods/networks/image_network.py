"""From a frame of voltages to an image of conductivity, whatever the sensor and the backbone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from eitbench.methods.networks.backbones import Mlp, SmallUNet, UNet
from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.sensors.patterns import averaging

if TYPE_CHECKING:
    from eitbench.methods.networks.backbones import Backbone
    from eitbench.scenarios.sensors.sensor import Sensor

BACKBONES: dict[str, type[Backbone]] = {
    "unet": UNet,
    "unet-small": SmallUNet,
    "mlp": Mlp,
}


class ImageNetwork(nn.Module):
    """Conductivity relative to the background, from differences to the reference frame.

    Measurements that reciprocity makes equal are averaged, and the averages divided by their
    standard deviation in the training data.

    Attributes:
        std: (K,) [V/A].

    Raises:
        InputError: an unknown backbone.
    """

    averaging: Tensor
    mask: Tensor
    std: Tensor

    def __init__(self, sensor: Sensor, backbone: str) -> None:
        super().__init__()
        if backbone not in BACKBONES:
            raise unknown_name("backbone", backbone, BACKBONES)
        matrix = torch.from_numpy(averaging(sensor.pattern)).float()
        # They follow from the sensor, so that they need not be stored.
        self.register_buffer("averaging", matrix, persistent=False)
        self.register_buffer("mask", torch.from_numpy(sensor.mask.copy()), persistent=False)
        self.register_buffer("std", torch.ones(matrix.shape[1]))
        self.backbone = BACKBONES[backbone](matrix.shape[1], sensor.image_shape)

    def inputs(self, difference: Tensor) -> Tensor:
        """Standardised independent values (n, K) of differences (n, M) [V/A]."""
        with torch.autocast(difference.device.type, enabled=False):
            return difference @ self.averaging / self.std

    def forward(self, difference: Tensor) -> Tensor:
        """Conductivity over background (n, H, W); 1 outside the sensor."""
        contrast: Tensor = self.backbone(self.inputs(difference))
        return 1 + contrast * self.mask
