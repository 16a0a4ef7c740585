"""Physics-informed networks that go on from the image of a trained network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from eitbench.methods.learned.image_networks import Dnn, UsesNetwork
from eitbench.methods.registry import register
from eitbench.methods.untrained.pinn import Pinn
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem
    from eitbench.scenarios.arrays import Array


@register("cnn-pinn")
@dataclass
class CnnPinn(UsesNetwork, Pinn):
    """The image of `dnn`, refined for each frame by the networks of `pinn` (CNN + PINN).

    By default its `steps` are one window, so that its image is the mean of all of them. For the
    attributes see `Pinn`.
    """

    name: ClassVar = "cnn-pinn"
    uses: ClassVar = Dnn
    expected_failures: ClassVar = {}
    learning_rate: ClassVar = 0.001  # the image is to be refined, not found

    steps: int = 100

    def fit(self, problem: Problem) -> None:
        """Prepare the equations, and load the weights of `dnn`.

        Raises:
            InputError: as of `Pinn.fit`; `dnn` has no weights for the sensor, or such as are used
                with gains of measurements.
            DataCorruptError: they are damaged.
        """
        super().fit(problem)
        self._dnn = self.fitted_network(problem)
        if self._dnn.effective_gain_power:
            raise InputError(
                f"{self.name!r} takes differences as they are measured, and the weights of 'dnn' "
                "were trained with --gain-power: train some without."
            )

    def first(self, difference: Array) -> Array:
        """See `FittedPerFrame`; the image of `dnn`."""
        image = self._dnn.relative(difference[None])[0].astype(np.float64)
        return np.asarray(image.clip(*self._problem.sensor.conductivity_range))
