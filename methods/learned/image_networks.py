"""Reconstruction by networks that were trained before: `dnn`, and `phydnn` with a physical loss."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import GAINS, Search, positive
from eitbench.methods.method import Method
from eitbench.methods.registry import register
from eitbench.methods.training import Recipe, Trainable
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.sensors.symmetry import mean_over, motions

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Mapping

    from torch import Tensor

    from eitbench.methods.networks.image_network import ImageNetwork
    from eitbench.methods.problem import Problem
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.scenarios.sensors.sensor import Sensor


BATCH = 64
"""Frames that go through a network at once: more would only take more memory."""

NETWORKS: Search = {**GAINS, "amplification": (1.0, 2.0, 4.0, 8.0)}
"""What is selected of trained networks."""

TRAINED_ON = ("scenario", "train_data", "train_samples", "seed")
"""Metadata of weights that name the data which they were trained on, and the seed."""


@dataclass
class TrainedMethod(Trainable, Method):
    """Base of the methods whose networks `eitbench train` trains.

    Attributes:
        weights: a file of weights to use; by default those for the sensor, the user's own or those
            that come with the package.
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`; 0 for
            that which the weights were trained with.
        effective_gain_power: which of the two it is, after `fit`.
        amplification: what differences are multiplied by before they go through the network, and
            contrasts are divided by after. To first order this is as if it had been trained with
            less noise by this factor: what a regularisation's weight is to others. Touches that are
            far weaker than those of training a network takes for noise.
        begun_train_s: the part of `train_s` that weights of another method took, with whose images
            it begins [s].
    """

    needs: ClassVar = "torch"
    search: ClassVar = NETWORKS
    effective_gain_power = 0.0
    begun_train_s = 0.0
    weights: str = ""
    gain_power: float = 0.0
    amplification: float = 1.0

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        if why := super().unusable(sensor):
            return why
        return "" if cls.files.content_hash(sensor) else cls.files.missing(sensor)

    def fit(self, problem: Problem) -> None:
        """Load the weights.

        Raises:
            InputError: there are none for the sensor, a negative power, or an amplification that is
                not above 0.
            DataCorruptError: they are damaged.
        """
        if not 0 <= self.gain_power < math.inf:
            raise InputError(f"The power of gains is at least 0, got {self.gain_power}.")
        positive("amplification", self.amplification)
        self._problem = problem
        own = Path(self.weights) if self.weights else None
        path, tensors, metadata = self.files.load(problem.sensor, own)
        import torch

        try:
            self.train_s = float(metadata["train_s"])
            self.trained_on = {name: metadata[name] for name in TRAINED_ON}
            self.trained_on |= {"unlimited": metadata.get("unlimited", "0")}
            self.effective_gain_power = self.gain_power or float(metadata.get("gain_power", "0"))
            # New networks draw weights, to be replaced, from torch's global generator.
            with torch.random.fork_rng(devices=[]):
                self.prepare(problem, tensors, metadata)
        except InputError:
            raise
        except (RuntimeError, KeyError, ValueError) as error:
            raise DataCorruptError(
                f"{path} does not hold the weights of {self.files.name!r}."
            ) from error

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        difference = self.amplified(voltages)
        low, high = self._problem.sensor.conductivity_range
        images = np.empty((len(difference), *self._problem.mask.shape))
        for first in range(0, len(difference), BATCH):
            part = slice(first, first + BATCH)
            images[part] = self.weakened(self.relative(difference[part])).clip(low, high)
        return images * self._problem.background

    def amplified(self, voltages: Array) -> Array:
        """Differences (n, M) [V/A] from frames (n, M), as the network takes them."""
        difference = self._problem.difference(voltages, self.effective_gain_power)
        return self.amplification * difference

    def weakened(self, relative: Images) -> Images:
        """Conductivity over background (..., H, W) of `relative` ones of amplified differences."""
        return relative / self.amplification + (1 - 1 / self.amplification)

    @abstractmethod
    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """Make the networks of a problem and give them the weights `tensors` of a file.

        Raises:
            RuntimeError, KeyError, ValueError: they do not fit.
        """

    @abstractmethod
    def relative(self, difference: Array) -> Images:
        """Return conductivity over background (n, H, W) of differences (n, M) [V/A]."""


class UsesNetwork(Method):
    """Base of the methods that have no weights of their own, but use another method's.

    Attributes:
        uses: the class of that method.
    """

    uses: ClassVar[type[TrainedMethod]]

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """See `Method`; of the other method's weights."""
        return cls.uses.weights_hash(sensor)

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return cls.uses.unusable(sensor)

    def fitted_network(
        self, problem: Problem, gain_power: float = 0.0, amplification: float = 1.0
    ) -> TrainedMethod:
        """The other method, fitted to a problem, whose training counts as this one's.

        Raises:
            InputError: there are no weights for the sensor.
            DataCorruptError: they are damaged.
        """
        network = self.uses(gain_power=gain_power, amplification=amplification)
        network.fit(problem)
        self.train_s, self.trained_on = network.train_s, network.trained_on
        return network


@dataclass
class ImageNetworkMethod(TrainedMethod):
    """Base of the methods that are one network from voltages to conductivity.

    Attributes:
        backbone: of its network, unless `eitbench train` is told another.
        beta: weight of the physical loss beside the data loss, as published; 0 for none.
    """

    source: ClassVar[str] = "Physics-Driven Learning Framework for Tomographic Tactile Sensing"
    recipe: ClassVar = Recipe(epochs=100, patience=25)
    options: ClassVar[tuple[str, ...]] = (
        "limit", "unlimited", "start", "loss", "operator", "alpha", "beta", "backbone",
        "gain_power",
    )  # fmt: skip
    backbone: ClassVar[str] = "unet"
    beta: ClassVar[float] = 0.0

    @classmethod
    def network(cls, sensor: Sensor, backbone: str) -> ImageNetwork:
        """Return a new network with the backbone of that name."""
        from eitbench.methods.networks.image_network import ImageNetwork

        return ImageNetwork(sensor, backbone)

    @classmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """See `Trainable`."""
        from eitbench.methods.learned.image_network_training import train_image_network

        return train_image_network(cls, job)

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
    ) -> None:
        """See `TrainedMethod`."""
        self._network = self.network(problem.sensor, metadata["backbone"])
        self._network.load_state_dict(tensors)
        self._network.eval().requires_grad_(requires_grad=False)
        self._motions = motions(problem.sensor, problem.jacobian)

    def relative(self, difference: Array) -> Images:
        """See `TrainedMethod`; the mean over the sensor's symmetries."""
        import torch

        moved = np.concatenate([motion.voltages(difference) for motion in self._motions])
        frames = torch.from_numpy(moved).float().to(self._network.std.device)
        images: Images = self._network(frames).cpu().numpy()
        return mean_over(self._motions, images)

    def to(self, device: str) -> None:
        """Move its network to a device, where another method is trained on its images."""
        self._network.to(device)


@register("dnn")
@dataclass
class Dnn(ImageNetworkMethod):
    """A U-Net from voltages to conductivity, trained on simulated touches (DNN)."""

    files: ClassVar = WeightFiles("dnn")


@register("phydnn")
@dataclass
class PhyDnn(ImageNetworkMethod):
    """The U-Net of `dnn`, trained to explain the measured voltages too (PhyDNN)."""

    files: ClassVar = WeightFiles("phydnn")
    beta: ClassVar = 0.0029
    options: ClassVar = tuple(o for o in ImageNetworkMethod.options if o != "loss")


@register("dnn-randomised")
@dataclass
class DnnRandomised(ImageNetworkMethod):
    """The U-Net of `dnn`, trained further on units with imperfections (domain randomisation)."""

    source: ClassVar[str] = "Tobin et al., IROS 2017, 23"
    files: ClassVar = WeightFiles("dnn-randomised")
    recipe: ClassVar = Recipe(epochs=25, rate=5e-4)
    begins_with: ClassVar = Dnn.files


@register("dnn-large")
@dataclass
class DnnLarge(ImageNetworkMethod):
    """A larger U-Net than that of `dnn`, trained on far more simulated touches."""

    files: ClassVar = WeightFiles("dnn-large")
    recipe: ClassVar = Recipe(epochs=52, batch=512, rate=1.5e-3)
    backbone: ClassVar = "unet-large"
