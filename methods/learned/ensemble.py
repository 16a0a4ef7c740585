"""The mean of a classical method's images and a trained method's, whose errors differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import GAINS
from eitbench.methods.classical.noser import Noser
from eitbench.methods.learned.image_networks import UsesNetwork
from eitbench.methods.learned.refined import LearnedGaussNewton
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array


@register("ensemble")
@dataclass
class Ensemble(UsesNetwork):
    """The mean of the images of NOSER and of `learned-gn`, for sensors that no model fits.

    On a real skin both err by the model, but not alike: NOSER leans on the measurements, the
    network on its training. NOSER is smooth and faint, so that its contrast is scaled to the energy
    of the network's before.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
        weight: of NOSER's regularisation, see `OneStep`.
    """

    source: ClassVar[str] = "Hansen and Salamon, IEEE Trans. Pattern Anal. 12(10), 1990"
    uses: ClassVar = LearnedGaussNewton
    search: ClassVar = {**GAINS, "weight": (0.03, 0.3, 1.0, 3.0)}

    gain_power: float = 0.0
    weight: float = 0.03

    def fit(self, problem: Problem) -> None:
        """Compute NOSER's matrix and load the weights.

        Raises:
            InputError: there are no weights for the sensor.
        """
        self._problem = problem
        self._network = self.fitted_network(problem, self.gain_power)
        self._noser = Noser(self.weight, gain_power=self._network.effective_gain_power)
        self._noser.fit(problem)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        background, mask = self._problem.background, self._problem.mask
        learned, linear = (
            np.where(mask, method.reconstruct(voltages) - background, 0.0)
            for method in (self._network, self._noser)
        )
        energies = (np.sqrt((part**2).sum(axis=(1, 2))) for part in (learned, linear))
        scale = np.array([a / b if b > 0 else 0.0 for a, b in zip(*energies, strict=True)])
        low, high = self._problem.sensor.conductivity_range
        images = background + (learned + scale[:, None, None] * linear) / 2
        return np.asarray(images.clip(low * background, high * background))
