"""Images of contacts that are made by hand, for tests of contacts and of tactile metrics."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes, foam16

Array = NDArray[np.float64]
FOAM = foam16()
PIXEL = 0.1 / 80


def disc_sensor() -> Sensor:
    outline = Disc(0.07)
    return replace(
        FOAM, name="disc", outline=outline, electrodes=even_electrodes(outline, 16, 0.01, 1e-3)
    )


def blobs(*discs: tuple[float, float, float, float], sensor: Sensor = FOAM) -> Array:
    """Contrast (1, H, W) with discs of x, y, radius [m] and contrast [S/m]."""
    x, y = sensor.pixel_centres
    image = np.zeros(sensor.image_shape)
    for x0, y0, radius, level in discs:
        image[np.hypot(x - x0, y - y0) < radius] = level
    return image[None]
