"""A stub of the sensor behind an emulated board: the nominal model and white noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.noise import add_noise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.press import FOAM
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors import Sensor


@dataclass(frozen=True)
class Touch:
    """A round indenter that presses on the sensor: its place and radius [m], its pressure [Pa]."""

    x_m: float
    y_m: float
    radius_m: float
    pressure_pa: float


class EmulatedSensor:
    """The nominal sensor with white noise of 60 dB."""

    def __init__(self, sensor: Sensor, unit: int = 0) -> None:
        self._sensor = sensor
        self._model = forward_model(sensor)
        self._rng = generator("emulated sensor", sensor.name, unit)

    def frame(self, time_s: float, touches: Sequence[Touch]) -> NDArray[np.float64]:
        """Voltages (M,) [V/A] at `time_s` [s] under `touches`."""
        x, y = self._sensor.pixel_centres
        sigma = np.full(self._sensor.image_shape, self._sensor.background)
        for touch in touches:
            distance = np.hypot(x - touch.x_m, y - touch.y_m) - touch.radius_m
            sigma *= FOAM.pressed(touch.pressure_pa, np.maximum(distance, 0))
        return add_noise(self._model.voltages(sigma), 60.0, self._rng)
