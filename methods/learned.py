"""Reconstruction by networks that were trained before: `dnn`, and `phydnn` with a physical loss."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.methods.method import Method
from eitbench.methods.registry import register
from eitbench.methods.weight_files import WeightFiles
from eitbench.scenarios.errors import DataCorruptError

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from eitbench.methods.problem import Problem

Array = NDArray[np.float64]

BATCH = 64
"""Frames that go through the network at once: more would only take more memory."""


@dataclass
class Learned(Method):
    """Base of the methods whose network `eitbench train` trains.

    Attributes:
        weights: a file of weights to use; by default those for the sensor, the user's own or those
            that come with the package.
        files: where these are looked for.
    """

    files: ClassVar[WeightFiles]

    weights: str = ""

    def fit(self, problem: Problem) -> None:
        """Load the network's weights.

        Raises:
            InputError: there are none for the sensor.
            DataCorruptError: they are damaged.
        """
        from eitbench.methods.networks.image_network import ImageNetwork

        self._problem = problem
        own = Path(self.weights) if self.weights else None
        path, tensors, about = self.files.load(problem.sensor, own)
        try:
            self._network = ImageNetwork(problem.sensor, about["backbone"])
            self._network.load_state_dict(tensors)
            self.train_s = float(about["train_s"])
        except (RuntimeError, KeyError, ValueError) as error:
            raise DataCorruptError(
                f"{path} does not hold the weights of {self.files.name!r}."
            ) from error
        self._network.eval().requires_grad_(requires_grad=False)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        import torch

        difference = torch.from_numpy(self._problem.difference(voltages)).float()
        relative = torch.cat([self._network(part) for part in torch.split(difference, BATCH)])
        low, high = self._problem.sensor.conductivity_range
        return relative.clamp(low, high).double().numpy() * self._problem.background


@register("dnn")
@dataclass
class Dnn(Learned):
    """A U-Net from voltages to conductivity, trained on simulated touches (DNN)."""

    source: ClassVar[str] = "Physics-Driven Learning Framework for Tomographic Tactile Sensing"
    files: ClassVar = WeightFiles("dnn", version="1")


@register("phydnn")
@dataclass
class PhyDnn(Learned):
    """The U-Net of `dnn`, trained to explain the measured voltages too (PhyDNN)."""

    source: ClassVar[str] = "Physics-Driven Learning Framework for Tomographic Tactile Sensing"
    files: ClassVar = WeightFiles("phydnn", version="1")
