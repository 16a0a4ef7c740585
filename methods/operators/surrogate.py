"""The learned forward operator: a linear physics branch, corrected by a convolutional network."""

from __future__ import annotations

import copy
import itertools
import math
from typing import TYPE_CHECKING, ClassVar

import torch
from torch import Tensor, nn

from eitbench.methods.networks.image_network import Block
from eitbench.methods.operator import Operator
from eitbench.methods.operators.jacobian import Jacobian
from eitbench.methods.registry import register_operator
from eitbench.methods.training import Recipe, Trainable
from eitbench.methods.training.augmentation import symmetries
from eitbench.methods.training.loop import Data, TrainingTask
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.sensors.patterns import independent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.methods.training.augmentation import Symmetry
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.sensors.sensor import Sensor

BATCH = 256
"""Images that go through the network at once: more would only take more memory."""

STEM = 4
"""Side [pixels] of the patches that the correction begins with."""

CHANNELS = (48, 64, 96)
"""Channels of its maps, each of half the side of the one before."""

HIDDEN = 256
"""Width of its dense head."""


@register_operator("surrogate")
class Surrogate(Trainable, Operator):
    """A network trained to predict the voltages; its weights come with the package or from you."""

    source: ClassVar[str] = "Physics-Driven Learning Framework for Tomographic Tactile Sensing"
    precision: ClassVar[str] = "float32"
    files: ClassVar = WeightFiles("surrogate")
    recipe: ClassVar = Recipe(epochs=40)

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        path, tensors, metadata = self.files.load(sensor)
        self._network = SurrogateNetwork(sensor)
        try:
            self._network.load_state_dict(tensors)
            self.train_s = float(metadata["train_s"])
            self.trained_on = metadata["device"]
        except (RuntimeError, KeyError, ValueError) as error:
            raise DataCorruptError(f"{path} does not hold the weights of a surrogate.") from error
        self._network.requires_grad_(requires_grad=False)
        self._copies: dict[tuple[torch.dtype, torch.device], SurrogateNetwork] = {}

    @classmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """See `Trainable`."""
        job.check()
        sensor = job.sensor
        sigma, voltages = job.clean_samples("train", job.training_count())
        seen_sigma, seen_voltages = job.clean_samples("validation", job.scenario.validation)
        with torch.random.fork_rng():
            torch.manual_seed(job.recipe.seed)
            network = SurrogateNetwork(sensor)
        linear = Jacobian(sensor)
        jacobian = linear.matrix.reshape(-1, *sensor.image_shape)
        mean, std = voltages.mean(0), voltages.std(0)
        std = std.clamp(min=1e-6 * std.max())  # a measurement that never changes
        network.start_from(mean, std, linear.reference, jacobian)
        return job.fit(
            SurrogateTask(network, symmetries(sensor, jacobian)),
            (sigma, voltages.float()),
            (seen_sigma, seen_voltages.float()),
            "the Jacobian",
            {"train_samples": str(len(sigma))},
        )

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        """The network's voltages: (n, H, W) to (n, M), in the precision and place of `sigma`."""
        key = (sigma.dtype, sigma.device)
        if key not in self._copies:
            self._copies[key] = copy.deepcopy(self._network).to(sigma)
        network = self._copies[key]
        return torch.cat([network.voltages(part) for part in torch.split(sigma, BATCH)])


class SurrogateNetwork(nn.Module):
    """Standardised voltages from conductivity: physics(contrast) + fusion * correction(image).

    The physics branch is linear and begins as the Jacobian; the correction begins at zero, so that
    an untrained network is the Jacobian operator. Both predict one of every two measurements that
    reciprocity makes equal; the other is its copy.

    Attributes:
        mean, std: (K,) of the independent voltages [V/A] that the network was trained on.
    """

    mean: Tensor
    std: Tensor
    first: Tensor
    owner: Tensor
    sign: Tensor

    def __init__(self, sensor: Sensor) -> None:
        super().__init__()
        height, width = sensor.image_shape
        first, owner, sign = independent(sensor.pattern)
        self.background = sensor.background
        self.magnitudes = sensor.pattern.magnitudes
        self.physics = nn.Linear(height * width, len(first))
        self.correction = Correction((height, width), len(first))
        self.fusion = nn.Parameter(torch.ones(()))
        self.register_buffer("mean", torch.zeros(len(first)))
        self.register_buffer("std", torch.ones(len(first)))
        # They follow from the sensor, so that they need not be stored.
        self.register_buffer("first", torch.from_numpy(first), persistent=False)
        self.register_buffer("owner", torch.from_numpy(owner), persistent=False)
        self.register_buffer("sign", torch.from_numpy(sign), persistent=False)

    def forward(self, sigma: Tensor) -> Tensor:
        """Standardised independent voltages (n, K) of conductivities (n, H, W) [S/m]."""
        relative = sigma / self.background
        # The root of the number of pixels keeps the weights, and so their updates, of order one.
        contrast = (relative - 1).flatten(1) / math.sqrt(self.physics.in_features)
        # The logarithm is nearly linear in the voltages up to strong contrasts.
        channels = torch.stack([relative - 1, relative.log()], dim=1)
        corrected: Tensor = self.physics(contrast) + self.fusion * self.correction(channels)
        return corrected

    def voltages(self, sigma: Tensor) -> Tensor:
        """Voltages (n, M) [V/A] of conductivities (n, H, W) [S/m]."""
        values: Tensor = (self.mean + self.std * self(sigma))[:, self.owner] * self.sign
        return values.abs() if self.magnitudes else values

    def standardised(self, voltages: Tensor) -> Tensor:
        """The independent of the voltages (n, M) [V/A], standardised (n, K)."""
        return (voltages[:, self.first] - self.mean) / self.std

    def start_from(self, mean: Tensor, std: Tensor, reference: Tensor, jacobian: Tensor) -> None:
        """Set the standardisation (M,) and make the physics branch the linearised model.

        `reference` (M,) [V/A] and `jacobian` (M, H, W) [V/A per S/m] belong to the background.
        """
        scale = self.background * math.sqrt(self.physics.in_features)
        slopes = jacobian[self.first].flatten(1)
        with torch.no_grad():
            self.mean.copy_(mean[self.first])
            self.std.copy_(std[self.first])
            self.physics.weight.copy_(slopes / std[self.first, None] * scale)
            self.physics.bias.copy_(((reference - mean) / std)[self.first])


class Correction(nn.Module):
    """Residual blocks on ever coarser grids, then a dense head that knows where things are."""

    def __init__(self, image_shape: tuple[int, int], n_outputs: int) -> None:
        super().__init__()
        height, width = (math.ceil(size / STEM) for size in image_shape)
        layers: list[nn.Module] = [_Coarser(2, CHANNELS[0], STEM), Block(CHANNELS[0])]
        for before, after in itertools.pairwise(CHANNELS):
            layers += [_Coarser(before, after, 2), Block(after)]
            height, width = math.ceil(height / 2), math.ceil(width / 2)
        self.maps = nn.Sequential(*layers)
        self.head = nn.Sequential(
            nn.Flatten(),
            nn.Linear(CHANNELS[-1] * height * width, HIDDEN),
            nn.GELU(),
            nn.Linear(HIDDEN, n_outputs),
        )
        last = self.head[-1]
        nn.init.zeros_(last.weight)  # type: ignore[arg-type]
        nn.init.zeros_(last.bias)  # type: ignore[arg-type]

    def forward(self, channels: Tensor) -> Tensor:
        """Corrections (n, K) from input channels (n, 2, H, W)."""
        values: Tensor = self.head(self.maps(channels))
        return values


class _Coarser(nn.Module):
    """Pixels to patches of `factor` x `factor` by a convolution; zeros complete the last ones."""

    def __init__(self, n_in: int, n_out: int, factor: int) -> None:
        super().__init__()
        self.factor = factor
        self.convolution = nn.Conv2d(n_in, n_out, factor, stride=factor)

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        missing = (0, -width % self.factor, 0, -height % self.factor)
        patches: Tensor = self.convolution(nn.functional.pad(x, missing))
        return patches


class SurrogateTask(TrainingTask):
    """Mean squared error of standardised voltages, over all measurements of a frame.

    In training, each batch is seen under a random symmetry of the sensor.
    """

    network: SurrogateNetwork
    shares: Tensor

    def __init__(self, network: SurrogateNetwork, motions: Sequence[Symmetry]) -> None:
        super().__init__(network)
        self._motions = motions
        shares = torch.bincount(network.owner) / len(network.owner)
        self.register_buffer("shares", shares.float(), persistent=False)

    def loss(self, batch: Data) -> Tensor:
        """Return the loss of conductivities (n, H, W) [S/m] and clean voltages (n, M) [V/A]."""
        sigma, voltages = batch
        if self.training:
            motion = self._motions[int(torch.randint(len(self._motions), ()))]
            sigma, voltages = motion.images(sigma), motion.voltages(voltages)
        error: Tensor = self.network(sigma) - self.network.standardised(voltages)
        return (error.square() @ self.shares).mean()
