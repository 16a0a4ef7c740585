"""An implicit neural representation: a network from the place in the sensor to the image there."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

FEATURES = 32
"""Random frequencies; each gives a sine and a cosine."""

HIDDEN = (64, 64, 64)


class PointNetwork(nn.Module):
    """From random Fourier features of points to values there (n, outputs), by a small perceptron.

    All values begin as zero.

    Source: Tancik et al., "Fourier Features Let Networks Learn High Frequency Functions", NeurIPS
    2020, equation 5.
    """

    features: Tensor

    def __init__(self, points: Tensor, outputs: int, bandwidth: float) -> None:
        """Make a network for given points.

        Args:
            points: (..., 2), from -1 to 1 over the longer side.
            outputs: values at each point.
            bandwidth: standard deviation of the frequencies [periods over the longer side].
        """
        super().__init__()
        frequencies = math.pi * bandwidth * torch.randn(2, FEATURES)
        phase = points @ frequencies
        self.register_buffer("features", torch.cat([phase.sin(), phase.cos()], dim=-1))
        layers: list[nn.Module] = []
        before = 2 * FEATURES
        for width in HIDDEN:
            layers += [nn.Linear(before, width), nn.SiLU()]
            before = width
        self.layers = nn.Sequential(*layers)
        self.leave = nn.Linear(before, outputs)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self) -> Tensor:
        """The values (..., outputs)."""
        values: Tensor = self.leave(self.layers(self.features))
        return values


class CoordinateNetwork(PointNetwork):
    """An image (H, W) as a network of the places of its pixels; zero at first."""

    def __init__(
        self, image_shape: tuple[int, int], pixel_size: tuple[float, float], bandwidth: float
    ) -> None:
        """Make a network for images of a shape (H, W); for `bandwidth` see `PointNetwork`.

        `pixel_size` (dx, dy) [m] is of each pixel.
        """
        height, width = image_shape
        aspect = pixel_size[1] / pixel_size[0]
        longer = max(aspect * height, width)
        y, x = torch.meshgrid(
            aspect * (2 * torch.arange(height) + 1 - height) / longer,
            (2 * torch.arange(width) + 1 - width) / longer,
            indexing="ij",
        )
        super().__init__(torch.stack([x, y], dim=-1), 1, bandwidth)

    def forward(self) -> Tensor:
        """The image (H, W)."""
        return super().forward()[..., 0]


class FieldNetworks(nn.Module):
    """An image (H, W), and potentials (n, E) at other points; both zero at first."""

    def __init__(
        self,
        image_shape: tuple[int, int],
        pixel_size: tuple[float, float],
        points: Tensor,
        electrodes: int,
        bandwidth: float,
    ) -> None:
        """See `CoordinateNetwork`; for `points` (n, 2) see `PointNetwork`; `electrodes` is E."""
        super().__init__()
        self.image = CoordinateNetwork(image_shape, pixel_size, bandwidth)
        self.potentials = PointNetwork(points, electrodes, bandwidth)

    def forward(self) -> Tensor:
        """The image (H, W)."""
        image: Tensor = self.image()
        return image
