"""Sensors by name: the default skin, one for every recorded set, and those of files."""

from dataclasses import replace
from pathlib import Path

from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.recordings import RECORDED_SETS, is_recording
from eitbench.scenarios.recordings.files.recording_file import recorded_sensor
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, SensorBuilder, even_electrodes
from eitbench.scenarios.sensors.sensor_file import read_sensor


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


def sensors() -> dict[str, SensorBuilder]:
    """Every sensor that can be asked for by name."""
    return {"foam16": foam16} | {s.sensor_name: s.sensor for s in RECORDED_SETS.values()}


def is_file(name: str) -> bool:
    """Whether `name` is the path of a sensor file (.toml) or of a recording (.h5)."""
    return name.endswith(".toml") or is_recording(name)


def sensor(name: str, *, offset: int | None = None) -> Sensor:
    """The sensor called `name`, or that of a sensor file (.toml) or a recording (.h5).

    Args:
        name: of a known sensor, or the path of a file.
        offset: replaces the drive pattern by (i, i+offset).

    Raises:
        InputError: unknown name (the nearest one is suggested), a sensor file that declares
            something wrong, or an impossible offset.
        DataUnavailableError, DataCorruptError: no such recording, or one that cannot be read.
    """
    nominal = _nominal(name)
    if offset is None:
        return nominal
    return replace(nominal, pattern=offset_pattern(nominal.n_electrodes, offset))


def _nominal(name: str) -> Sensor:
    if is_recording(name):
        return recorded_sensor(Path(name))
    if is_file(name):
        return read_sensor(Path(name))
    builders = sensors()
    if name not in builders:
        raise unknown_name("sensor", name, builders)
    return builders[name]()
