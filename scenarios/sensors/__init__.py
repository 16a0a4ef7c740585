"""Sensors: outlines, electrodes, drive patterns, sensor files."""

from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon, rectangle
from eitbench.scenarios.sensors.patterns import (
    DrivePattern,
    offset_pattern,
    opposition_pattern,
    pair_pattern,
)
from eitbench.scenarios.sensors.sensor import Electrode, Sensor, even_electrodes, foam16

__all__ = [
    "Disc",
    "DrivePattern",
    "Electrode",
    "Outline",
    "Polygon",
    "Sensor",
    "even_electrodes",
    "foam16",
    "offset_pattern",
    "opposition_pattern",
    "pair_pattern",
    "rectangle",
]
