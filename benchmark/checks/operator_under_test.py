"""The operator under test: its images and cotangents, and the service of its worker."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.benchmark.checks.harness import BrokenError, Check, SkippedError, require
from eitbench.benchmark.workers.messages import Reply
from eitbench.methods.operator import Operator
from eitbench.methods.registry import load_plugin, operator
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.suites.scenario import SimulatedScenario

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
    """An operator for a sensor, with some images and some cotangents.

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

    @classmethod
    def of(cls, make: Callable[[Sensor], Operator]) -> "OperatorUnderTest":
        """Make the operator for a small sensor, or for the default one if it has to be."""
        small = SMALL.nominal_sensor
        try:
            return cls(make, small)
        except EitbenchError:
            return cls(make, sensor_by_name(small.name))

    def random(self, *shape: int) -> Array:
        """Return the next random numbers from -1 to 1 of one stream."""
        return self._random.uniform(-1.0, 1.0, shape)

    @property
    def exact(self) -> bool:
        """True if the operator claims to solve the model's equations."""
        return type(self.operator).exact

    @cached_property
    def voltages(self) -> Array:
        """Voltages (3, M) of `sigma` [V/A]."""
        return self.voltages_of(self.sigma)

    @cached_property
    def gradient(self) -> Array:
        """Gradients (3, H, W): J(sigma)^T cotangent."""
        return self.gradient_of(self.sigma, self.cotangent)

    @cached_property
    def background(self) -> Array:
        """Voltages (M,) of the untouched sensor [V/A]."""
        image = np.full(self.sensor.image_shape, self.sensor.background)
        return self.voltages_of(image)

    def voltages_of(self, sigma: Array, operator: Operator | None = None) -> Array:
        """Return voltages as a plain array, which must be finite and of the right shape."""
        found = np.asarray((operator or self.operator).voltages(sigma.copy()))
        expected = (*sigma.shape[:-2], self.sensor.n_measurements)
        require(found.shape == expected, f"voltages have shape {found.shape}, not {expected}.")
        require(bool(np.isfinite(found).all()), "voltages hold values that are not finite.")
        return found

    def gradient_of(self, sigma: Array, cotangent: Array) -> Array:
        """Return the `vjp` as a plain array, which must be finite and of the right shape."""
        found = np.asarray(self.operator.vjp(sigma.copy(), cotangent.copy()))
        require(found.shape == sigma.shape, f"the vjp has shape {found.shape}, not {sigma.shape}.")
        require(bool(np.isfinite(found).all()), "the vjp holds values that are not finite.")
        return found


@dataclass
class OperatorCheckService:
    """The worker's side: makes the operator `name`, of the file `plugin` if one is given."""

    name: str
    plugin: Path | None

    def set_up(self) -> Reply:
        """Make the operator; the reply holds the image grid (H, W) of its sensor."""
        if self.plugin is not None:
            load_plugin(self.plugin)
        self._tested = OperatorUnderTest.of(partial(operator, self.name))
        return Reply(self._tested.sensor.image_shape, 0.0)

    def run(self, check: Check) -> Reply:
        """Run one check; the reply holds what is "measured", "broken", or why "skipped"."""
        try:
            return Reply({"measured": check(self._tested)}, 0.0)
        except BrokenError as finding:
            return Reply({"broken": str(finding)}, 0.0)
        except SkippedError as reason:
            return Reply({"skipped": str(reason)}, 0.0)


def close(first: Any, second: Any, allowed: float, what: str) -> str:
    """Return a sentence on ||first - second|| / ||second||, the relative difference of `what`.

    Raises:
        BrokenError: it is larger than `allowed`, or the shapes differ.
    """
    one, other = (np.asarray(a, dtype=np.float64) for a in (first, second))
    require(one.shape == other.shape, f"the shapes {one.shape} and {other.shape} differ.")
    error = float(np.linalg.norm(one - other)) / (float(np.linalg.norm(other)) or 1.0)
    require(error <= allowed, f"{what} differ by {error:.2g}; {allowed:g} is allowed.")
    return f"{what} differ by {error:.2g} ({allowed:g} is allowed)."
