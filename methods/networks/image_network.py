"""Networks from a frame of voltages to an image of conductivity, whatever the sensor.

A backbone is a linear map from voltages to an image, alone or corrected by a U-Net, a Fourier
neural operator or a perceptron.
"""

from __future__ import annotations

import itertools
from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from eitbench.methods.networks.fourier_operator import FourierLayers
from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.sensors.patterns import averaging

if TYPE_CHECKING:
    from eitbench.scenarios.sensors.sensor import Sensor


class Backbone(nn.Module):
    """Relative contrasts (n, H, W) from standardised differences (n, K).

    It begins as a linear map, for the correction begins at zero. The map is computed in full
    precision whatever the autocast: what is lost on voltages comes back magnified in the image.
    """

    def __init__(self, n_inputs: int, image_shape: tuple[int, int]) -> None:
        super().__init__()
        self.image_shape = image_shape
        self.linear = nn.Linear(n_inputs, image_shape[0] * image_shape[1])

    def forward(self, inputs: Tensor) -> Tensor:
        """The linear image plus its correction."""
        with torch.autocast(inputs.device.type, enabled=False):
            image = self.linear(inputs).view(-1, *self.image_shape)
        corrected: Tensor = image + self.correction(inputs, image).float()
        return corrected

    @abstractmethod
    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """Return what to add (n, H, W) to the linear `image` (n, H, W) of `inputs` (n, K)."""

    def start_from(self, matrix: Tensor) -> None:
        """Make `matrix` (K, H * W) the linear map."""
        with torch.no_grad():
            self.linear.weight.copy_(matrix.T)
            self.linear.bias.zero_()


PATCH = 4
"""Side [pixels] of the patches that are the finest grid's cells."""

CHANNELS = (32, 80, 160)
"""Channels of the maps, each of half the side of the one before."""

FEWER_CHANNELS = (16, 40, 80)
"""Those of the small network, which takes a third of the time."""

MORE_CHANNELS, MORE_BLOCKS = (80, 160, 320), 2
"""Those of the large network, and its blocks on every grid."""

LATENT = 10
"""Channels that come from the voltages directly, not by way of the linear image."""

HIDDEN = 192
"""Width of the layer between the voltages and these channels."""


class UNet(Backbone):
    """Corrects the linear image by what the image and the voltages themselves say."""

    channels: ClassVar = CHANNELS
    blocks: ClassVar = 1

    def __init__(self, n_inputs: int, image_shape: tuple[int, int]) -> None:
        super().__init__(n_inputs, image_shape)
        grid = coarse_grid(image_shape)
        self.latent = nn.Sequential(
            nn.Linear(n_inputs, HIDDEN),
            nn.GELU(),
            nn.Linear(HIDDEN, LATENT * grid[0] * grid[1]),
            nn.Unflatten(1, (LATENT, *grid)),
        )
        self.unet = PatchUNet(1, LATENT, image_shape, self.channels, self.blocks)

    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """See `Backbone`."""
        with torch.autocast(inputs.device.type, enabled=False):
            latent = self.latent(inputs)
        change: Tensor = self.unet(image[:, None], latent)
        return change


class SmallUNet(UNet):
    """The same with half of the channels."""

    channels: ClassVar = FEWER_CHANNELS


class LargeUNet(UNet):
    """The same with more channels, and twice the blocks."""

    channels: ClassVar = MORE_CHANNELS
    blocks: ClassVar = MORE_BLOCKS


def coarse_grid(image_shape: tuple[int, int]) -> tuple[int, int]:
    """Cells (h, w) of the finest grid that `PatchUNet` works on, for images (H, W)."""
    whole = PATCH * 2 ** (len(CHANNELS) - 1)
    height, width = (-(-size // whole) * whole for size in image_shape)
    return height // PATCH, width // PATCH


class PatchUNet(nn.Module):
    """A change (n, H, W), zero at first, from `count` images and `maps` maps on the coarse grid.

    The images are cut into patches. Many channels on a coarse grid cost far less time than few on
    the image's own.
    """

    def __init__(
        self,
        count: int,
        maps: int,
        image_shape: tuple[int, int],
        channels: tuple[int, ...] = CHANNELS,
        blocks: int = 1,
    ) -> None:
        """`blocks` is their number on every grid, on the way down and on the way up."""
        super().__init__()
        self.image_shape = image_shape
        height, width = (PATCH * size for size in coarse_grid(image_shape))
        self.missing = (0, width - image_shape[1], 0, height - image_shape[0])
        self.enter = nn.Conv2d(count * PATCH**2 + maps, channels[0], 3, padding=1)
        steps = list(itertools.pairwise(channels))
        self.encoder = nn.ModuleList(_blocks(size, blocks) for size in channels)
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in steps)
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, stride=2) for a, b in steps)
        self.merge = nn.ModuleList(nn.Conv2d(2 * a, a, 1) for a, _ in steps)
        self.decoder = nn.ModuleList(_blocks(a, blocks) for a, _ in steps)
        self.leave = nn.Conv2d(channels[0], PATCH**2, 3, padding=1)
        nn.init.zeros_(self.leave.weight)
        assert self.leave.bias is not None
        nn.init.zeros_(self.leave.bias)

    def forward(self, images: Tensor, maps: Tensor | None = None) -> Tensor:
        """(n, H, W) from `images` (n, count, H, W) and `maps` (n, maps, h, w) if it takes any."""
        if not len(images):  # patches of no image would have another shape
            return images[:, 0]
        z = functional.pixel_unshuffle(functional.pad(images, self.missing), PATCH)
        z = self.enter(z if maps is None else torch.cat([z, maps], dim=1))
        skips = []
        for block, down in itertools.zip_longest(self.encoder, self.down):
            z = block(z)
            if down is not None:
                skips.append(z)
                z = down(z)
        for up, merge, block in reversed(list(zip(self.up, self.merge, self.decoder, strict=True))):
            z = block(merge(torch.cat([up(z), skips.pop()], dim=1)))
        change = functional.pixel_shuffle(self.leave(functional.gelu(z)), PATCH)[:, 0]
        return change[:, : self.image_shape[0], : self.image_shape[1]]


def _blocks(channels: int, count: int) -> nn.Module:
    """So many blocks in a row; a single one is no sequence, as in weights of before."""
    blocks = [Block(channels) for _ in range(count)]
    return nn.Sequential(*blocks) if count > 1 else blocks[0]


class Block(nn.Module):
    """A residual block of two 3 x 3 convolutions, near the identity at first.

    There is no normalisation: how strong a contrast is must not be divided away.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """(n, C, h, w) to the same."""
        change: Tensor = self.second(functional.gelu(self.first(functional.gelu(x))))
        return x + change


WIDTH = 256


class Mlp(Backbone):
    """Two hidden layers beside the linear map."""

    def __init__(self, n_inputs: int, image_shape: tuple[int, int]) -> None:
        super().__init__(n_inputs, image_shape)
        last = nn.Linear(WIDTH, image_shape[0] * image_shape[1])
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.layers = nn.Sequential(
            nn.Linear(n_inputs, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH), nn.GELU(), last
        )

    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """See `Backbone`."""
        change: Tensor = self.layers(inputs)
        return change.view(image.shape)


class FourierOperator(Backbone):
    """Corrects the linear image by a Fourier neural operator."""

    def __init__(self, n_inputs: int, image_shape: tuple[int, int]) -> None:
        super().__init__(n_inputs, image_shape)
        self.layers = FourierLayers(image_shape, PATCH)

    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """See `Backbone`."""
        del inputs
        change: Tensor = self.layers(image)
        return change


class Linear(Backbone):
    """The linear map alone."""

    def correction(self, inputs: Tensor, image: Tensor) -> Tensor:
        """See `Backbone`."""
        del inputs
        return torch.zeros_like(image)


BACKBONES: dict[str, type[Backbone]] = {
    "unet": UNet,
    "unet-small": SmallUNet,
    "unet-large": LargeUNet,
    "mlp": Mlp,
    "fno": FourierOperator,
    "linear": Linear,
}


class ImageNetwork(nn.Module):
    """Conductivity relative to the background, from differences to the reference frame.

    Measurements that reciprocity makes equal are averaged, and the averages divided by their
    standard deviation in the training data.

    Attributes:
        sensor: that gives the frames.
        std: (K,) [V/A].

    Raises:
        InputError: an unknown backbone.
    """

    averaging: Tensor
    mask: Tensor
    std: Tensor

    def __init__(self, sensor: Sensor, backbone: str) -> None:
        super().__init__()
        self.sensor = sensor
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
