"""Means of the images of several methods, whose errors differ."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.noser import Noser
from eitbench.methods.learned.fourier_operator import Fno
from eitbench.methods.learned.image_networks import (
    NETWORKS,
    Dnn,
    PhyDnn,
    TrainedMethod,
    UsesNetwork,
)
from eitbench.methods.learned.learned_proximal import LearnedProximal
from eitbench.methods.learned.refined import LearnedGaussNewton
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor


@register("ensemble")
@dataclass
class Ensemble(UsesNetwork):
    """The mean of the images of NOSER and of `learned-gn`, for sensors that no model fits.

    On a real skin both err by the model, but not alike: NOSER leans on the measurements, the
    network on its training. NOSER is smooth and faint, so that its contrast is scaled to the energy
    of the network's before.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
        amplification: of frames for the network, see `TrainedMethod`.
        weight: of NOSER's regularisation, see `OneStep`.
    """

    source: ClassVar[str] = "Hansen and Salamon, IEEE Trans. Pattern Anal. 12(10), 1990"
    uses: ClassVar = LearnedGaussNewton
    search: ClassVar = {**NETWORKS, "weight": (0.03, 0.3, 1.0, 3.0)}

    gain_power: float = 0.0
    amplification: float = 1.0
    weight: float = 0.03

    def fit(self, problem: Problem) -> None:
        """Compute NOSER's matrix and load the weights.

        Raises:
            InputError: there are no weights for the sensor.
        """
        self._problem = problem
        self._network = self.fitted_network(problem, self.gain_power, self.amplification)
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


@register("network-ensemble")
@dataclass
class NetworkEnsemble(Method):
    """The mean of the images of networks of several kinds, and how far they are apart.

    Networks were trained on the same phantoms. What all of them get wrong alike does not show.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
        amplification: of frames, see `TrainedMethod`.
    """

    source: ClassVar[str] = "Lakshminarayanan, Pritzel and Blundell, NIPS 30, 2017, 6402"
    search: ClassVar = NETWORKS
    kinds: ClassVar[tuple[type[TrainedMethod], ...]] = (
        Dnn, PhyDnn, Fno, LearnedGaussNewton, LearnedProximal,
    )  # fmt: skip

    gain_power: float = 0.0
    amplification: float = 1.0

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """See `Method`; of the weights of all of its networks."""
        hashes = [of.weights_hash(sensor) for of in cls.kinds]
        return sha256(" ".join(hashes).encode()).hexdigest() if any(hashes) else ""

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`; it needs the weights of two networks."""
        lacking = list(filter(None, (of.unusable(sensor) for of in cls.kinds)))
        return lacking[-1] if len(lacking) > len(cls.kinds) - 2 else ""

    @classmethod
    def usable(cls, sensor: Sensor) -> list[type[TrainedMethod]]:
        """The kinds of networks that have weights for a sensor."""
        return [of for of in cls.kinds if not of.unusable(sensor)]

    def fit(self, problem: Problem) -> None:
        """Load the weights.

        Raises:
            InputError: there are none for the sensor, or those of one network only.
        """
        if why := self.unusable(problem.sensor):
            raise InputError(why)
        self._networks = [
            of(gain_power=self.gain_power, amplification=self.amplification)
            for of in self.usable(problem.sensor)
        ]
        for network in self._networks:
            network.fit(problem)
        # Networks that begin with the image of another count its training as theirs.
        self.train_s = sum(of.train_s - of.begun_train_s for of in self._networks)
        trained = [of.trained_on for of in self._networks]
        self.trained_on = dict(trained[0])
        for name in ("train_samples", "unlimited"):
            self.trained_on[name] = max((of[name] for of in trained), key=int)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        return np.asarray(np.mean(self._images(voltages), axis=0))

    def uncertainty(self, voltages: Array) -> Array:
        """Standard deviation (n, H, W) [S/m] of the networks' images of frames (n, M)."""
        return np.asarray(np.std(self._images(voltages), axis=0, ddof=1))

    def _images(self, voltages: Array) -> list[Array]:
        return [network.reconstruct(voltages) for network in self._networks]
