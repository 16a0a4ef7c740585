"""Physics-informed networks that go on from the image of a trained network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.learned.image_networks import Dnn
from eitbench.methods.registry import register
from eitbench.methods.untrained.pinn import Pinn

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem
    from eitbench.scenarios.arrays import Array
    from eitbench.scenarios.sensors.sensor import Sensor


@register("cnn-pinn")
@dataclass
class CnnPinn(Pinn):
    """The image of `dnn`, refined for each frame by the networks of `pinn` (CNN + PINN).

    For the attributes see `Pinn`.
    """

    name: ClassVar = "cnn-pinn"
    expected_failures: ClassVar = {}
    learning_rate: ClassVar = 0.001  # the image is to be refined, not found

    steps: int = 100

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """SHA-256 (hex) of the weights of `dnn`."""
        return Dnn.weights_hash(sensor)

    @classmethod
    def unusable(cls, sensor: Sensor) -> str:
        """See `Method`."""
        return Dnn.unusable(sensor)

    def fit(self, problem: Problem) -> None:
        """Prepare the equations, and load the weights of `dnn`.

        Raises:
            InputError: as of `Pinn.fit`; `dnn` has no weights for the sensor.
            DataCorruptError: they are damaged.
        """
        super().fit(problem)
        self._dnn = Dnn()
        self._dnn.fit(problem)
        self.train_s, self.trained_on = self._dnn.train_s, self._dnn.trained_on

    def first(self, difference: Array) -> Array:
        """See `FittedPerFrame`; the image of `dnn`."""
        image = self._dnn.relative(difference[None])[0].astype(np.float64)
        return np.asarray(image.clip(*self._problem.sensor.conductivity_range))
