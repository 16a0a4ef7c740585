"""The reference frame of a live view: the mean of frames of the untouched sensor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.methods import Problem
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]

FRAMES = 10
NO_DATA = (
    "it learns from simulated touches before its first image, and the live view has none: choose "
    "another method."
)


@dataclass(frozen=True, eq=False)
class Reference:
    """The reference frame of a board, and its units.

    Attributes:
        values: (M,) the mean frame in the board's units.
        gain: board's units per V/A.
        noise: rms over the values of the standard deviation of one frame [board's units].
    """

    values: Array
    gain: float
    noise: float

    def difference(self, values: Array) -> Array:
        """A frame (M,) minus the reference frame, in model units: (M,) [V/A]."""
        return np.asarray((values - self.values) / self.gain)

    def deviation(self, values: Array) -> float:
        """Distance of a frame (M,) from the reference frame, in standard deviations of noise."""
        distance = float(np.sqrt(np.mean((values - self.values) ** 2)))
        return distance / self.noise if self.noise > 0 else np.inf


def reference_of(sensor: Sensor, frames: Sequence[Array]) -> Reference:
    """The reference from `frames` (M,) of the untouched sensor, at least two.

    Raises:
        InputError: the frames do not match the sensor's drive pattern, or are not finite.
    """
    stack = np.array(frames)
    problem = Problem(sensor, stack.mean(axis=0), no_data)
    noise = float(np.sqrt(np.mean(stack.var(axis=0, ddof=1))))
    return Reference(problem.reference, problem.gain, noise)


def no_data(split: str, limit: int | None) -> Dataset:
    """Refuse: the live view has no data for methods that learn when they are fitted."""
    raise InputError(NO_DATA)
