"""An implicit neural representation: a network from the place in the sensor to the image there."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

FEATURES = 32
"""Random frequencies; each gives a sine and a cosine."""

HIDDEN = (64, 64, 64)


class CoordinateNetwork(nn.Module):
    """From random Fourier features of the coordinates to an image (H, W), by a small perceptron.

    Coordinates run from -1 to 1 over the longer side. The image begins as zero everywhere.

    Source: Tancik et al., "Fourier Features Let Networks Learn High Frequency Functions", NeurIPS
    2020, equation 5.
    """

    features: Tensor

    def __init__(self, image_shape: tuple[int, int], bandwidth: float) -> None:
        """Make a network for images of a shape.

        Args:
            image_shape: (H, W).
            bandwidth: standard deviation of the frequencies [periods over the longer side].
        """
        super().__init__()
        height, width = image_shape
        longer = max(image_shape)
        y, x = torch.meshgrid(
            (2 * torch.arange(height) + 1 - height) / longer,
            (2 * torch.arange(width) + 1 - width) / longer,
            indexing="ij",
        )
        frequencies = math.pi * bandwidth * torch.randn(2, FEATURES)
        phase = torch.stack([x, y], dim=-1) @ frequencies
        self.register_buffer("features", torch.cat([phase.sin(), phase.cos()], dim=-1))
        layers: list[nn.Module] = []
        before = 2 * FEATURES
        for width in HIDDEN:
            layers += [nn.Linear(before, width), nn.SiLU()]
            before = width
        self.layers = nn.Sequential(*layers)
        self.leave = nn.Linear(before, 1)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self) -> Tensor:
        """The image (H, W)."""
        image: Tensor = self.leave(self.layers(self.features))[..., 0]
        return image
