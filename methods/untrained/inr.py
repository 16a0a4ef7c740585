"""Implicit neural representation: a network of the coordinates, fitted to a single frame."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from eitbench.methods.registry import register
from eitbench.methods.untrained.network_per_frame import NetworkPerFrame
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from torch import nn

    from eitbench.methods.problem import Problem


@register("inr")
@dataclass
class Inr(NetworkPerFrame):
    """An untrained network of the coordinates per frame, fitted to its voltages.

    For the other attributes see `NetworkPerFrame`.

    Attributes:
        bandwidth: of the random frequencies of the coordinates [periods over the longer side]; more
            can show sharper edges, and more noise.
    """

    source: ClassVar[str] = "Tancik et al., NeurIPS 2020; Tong, Wang and Liu, arXiv 2409.04494"
    expected_failures: ClassVar = asymmetry("its random frequencies have no symmetry")
    name: ClassVar = "inr"
    learning_rate: ClassVar[float] = 0.003

    bandwidth: float = 0.5

    def fit(self, problem: Problem) -> None:
        """Prepare the operator and its misfit.

        Raises:
            InputError: as of `NetworkPerFrame.fit`; a bandwidth that is not positive.
        """
        if not 0 < self.bandwidth < math.inf:
            raise InputError(f"'inr' needs a positive bandwidth, got {self.bandwidth}.")
        super().fit(problem)

    def network(self) -> nn.Module:
        """Return a perceptron of random Fourier features."""
        from eitbench.methods.networks.coordinate_network import CoordinateNetwork

        pixel_size = self._problem.sensor.pixel_size
        return CoordinateNetwork(self._problem.mask.shape, pixel_size, self.bandwidth)
