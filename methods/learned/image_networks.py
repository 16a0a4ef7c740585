"""Reconstruction by networks that were trained before: `dnn`, and `phydnn` with a physical loss."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.methods.method import Method
from eitbench.methods.registry import register
from eitbench.methods.weights.weight_files import WeightFiles
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Mapping

    from torch import Tensor

    from eitbench.methods.problem import Problem
    from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]
Images = NDArray[np.float32]

BATCH = 64
"""Frames that go through a network at once: more would only take more memory."""

MOVED = "touches that were turned and mirrored at random taught it symmetry, nearly"
"""Why a network that was trained here has the sensor's symmetry in part."""


TRAINED_ON = ("scenario", "train_data", "train_samples")
"""What of the notes with weights says which data they come from."""


@dataclass
class Learned(Method):
    """Base of the methods whose networks `eitbench train` trains.

    Attributes:
        weights: a file of weights to use; by default those for the sensor, the user's own or those
            that come with the package.
        files: where these are looked for.
    """

    files: ClassVar[WeightFiles]

    weights: str = ""

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return cls.files.content_hash(sensor)

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return "" if cls.files.content_hash(sensor) else cls.files.missing(sensor)

    def fit(self, problem: Problem) -> None:
        """Load the weights.

        Raises:
            InputError: there are none for the sensor.
            DataCorruptError: they are damaged.
        """
        self._problem = problem
        own = Path(self.weights) if self.weights else None
        path, tensors, about = self.files.load(problem.sensor, own)
        import torch

        try:
            self.train_s = float(about["train_s"])
            self.trained_on = {name: about[name] for name in TRAINED_ON}
            # Networks draw weights, to be replaced, from the generator that is everybody's.
            with torch.random.fork_rng(devices=[]):
                self.prepare(problem, tensors, about)
        except InputError:
            raise
        except (RuntimeError, KeyError, ValueError) as error:
            raise DataCorruptError(
                f"{path} does not hold the weights of {self.files.name!r}."
            ) from error

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        difference = self._problem.difference(voltages)
        low, high = self._problem.sensor.conductivity_range
        images = np.empty((len(difference), *self._problem.mask.shape))
        for first in range(0, len(difference), BATCH):
            part = slice(first, first + BATCH)
            images[part] = self.relative(difference[part]).clip(low, high)
        return images * self._problem.background

    @abstractmethod
    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], about: Mapping[str, str]
    ) -> None:
        """Make the networks of a problem and give them the weights `tensors` of a file.

        Raises:
            RuntimeError, KeyError, ValueError: they do not fit.
        """

    @abstractmethod
    def relative(self, difference: Array) -> Images:
        """Conductivity over background (n, H, W) from differences to the reference (n, M) [V/A]."""


@dataclass
class OneNetwork(Learned):
    """Base of the methods that are one network from voltages to conductivity."""

    source: ClassVar[str] = "Physics-Driven Learning Framework for Tomographic Tactile Sensing"

    def prepare(
        self, problem: Problem, tensors: Mapping[str, Tensor], about: Mapping[str, str]
    ) -> None:
        """See `Learned`."""
        from eitbench.methods.networks.image_network import ImageNetwork

        self._network = ImageNetwork(problem.sensor, about["backbone"])
        self._network.load_state_dict(tensors)
        self._network.eval().requires_grad_(requires_grad=False)

    def relative(self, difference: Array) -> Images:
        """See `Learned`."""
        import torch

        images: Images = self._network(torch.from_numpy(difference).float()).numpy()
        return images


@register("dnn")
@dataclass
class Dnn(OneNetwork):
    """A U-Net from voltages to conductivity, trained on simulated touches (DNN)."""

    expected_failures: ClassVar = asymmetry(MOVED, 0.064, 0.048)
    files: ClassVar = WeightFiles("dnn", version="1")


@register("phydnn")
@dataclass
class PhyDnn(OneNetwork):
    """The U-Net of `dnn`, trained to explain the measured voltages too (PhyDNN)."""

    expected_failures: ClassVar = asymmetry(MOVED, 0.079, 0.060)
    files: ClassVar = WeightFiles("phydnn", version="1")
