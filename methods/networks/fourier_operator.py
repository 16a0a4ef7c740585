"""Fourier neural operator: convolutions over the whole image, learned by their lowest modes."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

MODES = 8
"""Lowest modes in each direction that a layer keeps, at most those that the grid has."""

WIDTH = 28
"""Channels of the maps."""

LAYERS = 4

MARGIN = 4
"""Zero cells beside the grid: the Fourier transform is periodic, and the sensor is not."""

HIDDEN = 128
"""Width of the layer before the image."""


class SpectralConvolution(nn.Module):
    """Periodic convolution of maps (n, h, w, C) by kernels of few Fourier modes.

    Of the transform F the lowest modes k are kept, and each is multiplied by a complex matrix R_k
    (C, C): F^-1(R_k F(z)_k). All is float32 whatever the autocast, for there is no Fourier
    transform in bfloat16.
    """

    def __init__(self, channels: int, grid: tuple[int, int]) -> None:
        super().__init__()
        self.modes = (min(MODES, grid[0] // 2), min(MODES, grid[1] // 2))
        # Real and imaginary parts in one real tensor: files of weights hold no complex numbers.
        shape = (2 * self.modes[0], self.modes[1], channels, channels, 2)
        self.matrices = nn.Parameter(torch.randn(shape) / math.sqrt(2 * channels))

    def forward(self, maps: Tensor) -> Tensor:
        """(n, h, w, C) to the same."""
        rows, columns = self.modes
        with torch.autocast(maps.device.type, enabled=False):
            spectrum = torch.fft.rfft2(maps.float(), dim=(1, 2), norm="ortho")
            height, width = spectrum.shape[1:3]
            # Frequencies along the rows run from 0 up, then from below back to -1.
            low = torch.cat([spectrum[:, :rows], spectrum[:, height - rows :]], dim=1)
            low = self._multiplied(low[:, :, :columns])
            dropped = (0, 0, 0, 0, 0, height - 2 * rows)
            kept = torch.cat([functional.pad(low[:, :rows], dropped), low[:, rows:]], dim=1)
            kept = functional.pad(kept, (0, 0, 0, width - columns))
            convolved: Tensor = torch.fft.irfft2(kept, maps.shape[1:3], (1, 2), norm="ortho")
        return convolved

    def _multiplied(self, modes: Tensor) -> Tensor:
        """R_k z_k of complex z (n, 2 m, m, C), as real matrices of twice the size: far faster."""
        real, imaginary = self.matrices.unbind(-1)
        parts = torch.stack([real, imaginary], -1), torch.stack([-imaginary, real], -1)
        matrices = torch.stack(parts, -3).flatten(-2).flatten(-3, -2)
        pairs = torch.view_as_real(modes.permute(1, 2, 0, 3)).flatten(-2)
        product = (pairs @ matrices).view(*pairs.shape[:-1], -1, 2)
        return torch.view_as_complex(product).permute(2, 0, 1, 3)


class FourierLayers(nn.Module):
    """A change (n, H, W), zero at first, from images (n, H, W).

    Images are cut into patches, the cells of the grid that the operator works on; where a cell is
    in the sensor is an input, too. Each layer adds to the maps what a spectral convolution and a
    pointwise map make of them.

    Source: Li et al., "Fourier Neural Operator for Parametric Partial Differential Equations",
    ICLR 2021, equations 2 and 5; with the skip of Tran et al., "Factorized Fourier Neural
    Operators", ICLR 2023.
    """

    places: Tensor

    def __init__(self, image_shape: tuple[int, int], patch: int) -> None:
        """`patch` is the side of a patch [pixels]."""
        super().__init__()
        self.image_shape, self.patch = image_shape, patch
        height, width = (-(-size // patch) for size in image_shape)
        self.missing = (0, patch * width - image_shape[1], 0, patch * height - image_shape[0])
        axes = torch.linspace(-1, 1, height), torch.linspace(-1, 1, width)
        places = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)
        self.register_buffer("places", places, persistent=False)
        wider = (height + MARGIN, width + MARGIN)
        self.lift = nn.Linear(patch**2 + 2, WIDTH)
        self.spectral = nn.ModuleList(SpectralConvolution(WIDTH, wider) for _ in range(LAYERS))
        self.pointwise = nn.ModuleList(nn.Linear(WIDTH, WIDTH) for _ in range(LAYERS))
        self.hidden = nn.Linear(WIDTH, HIDDEN)
        self.leave = nn.Linear(HIDDEN, patch**2)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, images: Tensor) -> Tensor:
        """(n, H, W) to the same."""
        padded = functional.pad(images[:, None], self.missing)
        patches = functional.pixel_unshuffle(padded, self.patch).permute(0, 2, 3, 1)
        places = self.places.expand(len(images), -1, -1, -1)
        z = self.lift(torch.cat([patches, places], dim=-1))
        height, width = z.shape[1:3]
        z = functional.pad(z, (0, 0, 0, MARGIN, 0, MARGIN))
        for spectral, pointwise in zip(self.spectral, self.pointwise, strict=True):
            z = z + functional.gelu(spectral(z) + pointwise(z))
        z = self.leave(functional.gelu(self.hidden(z[:, :height, :width])))
        change = functional.pixel_shuffle(z.permute(0, 3, 1, 2), self.patch)[:, 0]
        return change[:, : self.image_shape[0], : self.image_shape[1]]
