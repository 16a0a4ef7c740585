"""Streams of bytes as boards send them, made with the emulated end of each protocol."""

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.protocols import PROTOCOLS
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.sensors import Sensor

NAMES = sorted(PROTOCOLS)
UNITS = {"openeit": 1e-3}
"""V/A of one unit of a board's values, where that is not 1."""
STEPS = {"openeit": 1e-7, "eit-kit": 1e-4}
"""What a board rounds to [V/A], where it sends text."""


def sensor_of(name: str) -> Sensor:
    return sensor(PROTOCOLS[name].default_sensor)


def sent_values(name: str, count: int, seed: int = 0) -> NDArray[np.float64]:
    """Values (count, M) [V/A] such as a sensor has."""
    nominal = sensor_of(name)
    rng = np.random.default_rng(seed)
    # Differences of potentials, so that a board that sends potentials can send them, too.
    potentials = rng.normal(size=(count, nominal.n_electrodes, nominal.n_electrodes))
    src, _, a, b = nominal.pattern.table.T
    values = potentials[:, src, a] - potentials[:, src, b]
    return np.abs(values) if nominal.pattern.magnitudes else values


def messages(name: str, values: NDArray[np.float64], rate_hz: float = 10.0) -> list[bytes]:
    """The bytes of every frame of `values` (n, M), from a board that was started by its host."""
    nominal = sensor_of(name)
    device = PROTOCOLS[name].device(nominal)
    for command in PROTOCOLS[name](nominal).starting():
        device.obey(command)
    assert device.running
    # From 1, as the first frame of some comes with free text.
    return [device.encode(k, k / rate_hz, frame) for k, frame in enumerate(values, start=1)]
