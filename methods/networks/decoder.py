"""A small decoder that is never trained on anything: its shape is a prior on images."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn
from torch.nn import functional

CHANNELS = (64, 48, 32, 16)
"""Channels of the maps, each of twice the side of the one before; the last is as fine as the image.

Of the networks tried on validation frames, those with four maps did better than those with five.
"""

INPUTS = 16
"""Channels of the random input."""


class Decoder(nn.Module):
    """From a fixed random input on a coarse grid to an image, by convolutions and enlargements.

    Every pixel's channels are normalised together (layer normalisation), which leaves the image
    free to jump from one pixel to the next. With batch or instance normalisation, the usual choice,
    edges stay soft: on clean validation frames the images were 2 to 3 dB worse.

    Each convolution comes before the enlargement, for a quarter of the multiplications; images of
    validation frames were as good. The last one is of single pixels.

    The image begins as zero everywhere.
    """

    seed_map: Tensor

    def __init__(self, image_shape: tuple[int, int]) -> None:
        super().__init__()
        self.image_shape = image_shape
        factor = 2 ** (len(CHANNELS) - 1)
        height, width = (-(-size // factor) for size in image_shape)
        self.register_buffer("seed_map", torch.randn(1, INPUTS, height, width))
        *first, last = itertools.pairwise((INPUTS, *CHANNELS))
        convolutions = [nn.Conv2d(a, b, 3, padding=1) for a, b in first]
        self.convolutions = nn.ModuleList([*convolutions, nn.Conv2d(*last, 1)])
        self.norms = nn.ModuleList(nn.LayerNorm(channels) for channels in CHANNELS)
        self.leave = nn.Linear(CHANNELS[-1], 1)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)
        # With the channels last, normalising them takes half of the time.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self) -> Tensor:
        """The image (H, W)."""
        z = self.seed_map
        for level, (convolution, norm) in enumerate(
            zip(self.convolutions, self.norms, strict=True)
        ):
            z = convolution(z)
            if level:
                z = functional.interpolate(z, scale_factor=2, mode="bilinear")
            pixels = functional.leaky_relu(norm(z.permute(0, 2, 3, 1)), 0.2)
            z = pixels.permute(0, 3, 1, 2)
        image: Tensor = self.leave(pixels)[0, :, :, 0]
        return image[: self.image_shape[0], : self.image_shape[1]]
