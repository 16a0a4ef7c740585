"""The operator under test, with the images and cotangents that checks ask it about."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.checks.checking import require
from eitbench.methods.operator import Operator
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario

Array = NDArray[np.float64]

# Coarse, so that checks take seconds. Operators that exist for one image grid only are checked on
# the sensor's own.
SMALL = SimulatedScenario(
    name="check-operators",
    image_shape=(16, 16),
    families=("circle", "rectangle"),
    train=0,
    validation=3,
    test=0,
)
IMAGES = 3


class OperatorUnderTest:
    """An operator of a sensor, some images and some cotangents.

    Attributes:
        make: makes the operator for any sensor.
        operator: the one for `sensor`.
        sigma: (3, H, W) [S/m].
        cotangent: (3, M).
    """

    def __init__(self, make: Callable[[Sensor], Operator], sensor: Sensor) -> None:
        self.make = make
        self.sensor = sensor
        self.operator = make(sensor)
        drawn = [phantom(SMALL, "validation", k) for k in range(IMAGES)]
        self.sigma: Array = np.array([rasterise(p, sensor) for p in drawn])
        self._random = np.random.default_rng(0)
        self.cotangent = self.random(IMAGES, sensor.n_measurements)

    def random(self, *shape: int) -> Array:
        """Random numbers from -1 to 1, the next of one stream."""
        return self._random.uniform(-1.0, 1.0, shape)

    @property
    def exact(self) -> bool:
        """Whether the operator claims to solve the model's equations."""
        return type(self.operator).exact

    @cached_property
    def voltages(self) -> Array:
        """(3, M) of `sigma` [V/A]."""
        return self.asked_voltages(self.sigma)

    @cached_property
    def gradient(self) -> Array:
        """(3, H, W): J(sigma)^T cotangent."""
        return self.asked_gradient(self.sigma, self.cotangent)

    @cached_property
    def background(self) -> Array:
        """(M,) of the untouched sensor [V/A]."""
        image = np.full(self.sensor.image_shape, self.sensor.background)
        return self.asked_voltages(image)

    @cached_property
    def response(self) -> float:
        """Norm of what the images change in the voltages, by image on average [V/A]."""
        changes = np.linalg.norm(self.voltages - self.background, axis=-1)
        return float(np.sqrt(np.mean(changes**2)))

    def asked_voltages(self, sigma: Array, operator: Operator | None = None) -> Array:
        """Voltages as a plain array, which must be finite and of the right shape."""
        found = np.asarray((operator or self.operator).voltages(sigma.copy()))
        expected = (*sigma.shape[:-2], self.sensor.n_measurements)
        require(found.shape == expected, f"voltages have shape {found.shape}, not {expected}.")
        require(bool(np.isfinite(found).all()), "voltages hold values that are not finite.")
        return found

    def asked_gradient(self, sigma: Array, cotangent: Array) -> Array:
        """`vjp` as a plain array, which must be finite and of the right shape."""
        found = np.asarray(self.operator.vjp(sigma.copy(), cotangent.copy()))
        require(found.shape == sigma.shape, f"the vjp has shape {found.shape}, not {sigma.shape}.")
        require(bool(np.isfinite(found).all()), "the vjp holds values that are not finite.")
        return found


def apart(first: Any, second: Any) -> float:
    """||first - second|| / ||second|| of two arrays of any kind."""
    one, other = (np.asarray(a, dtype=np.float64) for a in (first, second))
    require(one.shape == other.shape, f"the shapes {one.shape} and {other.shape} differ.")
    size = float(np.linalg.norm(other))
    return float(np.linalg.norm(one - other)) / size if size > 0 else float(np.linalg.norm(one))


def close(first: Any, second: Any, allowed: float, what: str) -> str:
    """Require `what`, the relative difference of two arrays, to be at most `allowed`; say it.

    Raises:
        BrokenError: it is larger.
    """
    error = apart(first, second)
    require(error <= allowed, f"{what} differ by {error:.2g}; {allowed:g} is allowed.")
    return f"{what} differ by {error:.2g} ({allowed:g} is allowed)."
