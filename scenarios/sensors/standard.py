"""Standard sensors."""

from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes


def foam16() -> Sensor:
    """The default sensor: a 0.1 m square of conductive foam with 16 electrodes, offset 3.

    Electrodes are 10 mm wide, four a side, centred at 12.5, 37.5, 62.5 and 87.5 mm, numbered
    counter-clockwise from the lower-left corner; contact impedance 1e-3 Ohm*m, background 1 S/m,
    which a touch can only lower.
    """
    outline = rectangle(0.1, 0.1)
    electrodes = even_electrodes(outline, 16, 0.01, 1e-3, start=0.0125)
    return Sensor(
        "foam16", outline, electrodes, offset_pattern(16, 3), conductivity_range=(0.05, 1.0)
    )
