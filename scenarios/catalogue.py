"""Sensors by name: the default one, those of the recorded sets, and those of files."""

from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path

from eitbench.scenarios.errors import unknown_name
from eitbench.scenarios.recordings import RECORDED_SETS, is_recording
from eitbench.scenarios.recordings.files.recording_file import recorded_sensor
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, SensorBuilder, foam16
from eitbench.scenarios.sensors.sensor_file import read_sensor


def sensors() -> dict[str, SensorBuilder]:
    """Builders of all sensors that have a name."""
    return {"foam16": foam16} | {s.sensor_name: s.sensor for s in RECORDED_SETS.values()}


def is_file(name: str) -> bool:
    """True if `name` is the path of a sensor file (.toml) or of a recording (.h5)."""
    return name.endswith(".toml") or is_recording(name)


def sensor(name: str, *, offset: int | None = None) -> Sensor:
    """The sensor called `name`, that of a recorded set, of a sensor file or of a recording.

    Args:
        name: of a known sensor or recorded set, or the path of a file (.toml or .h5).
        offset: replaces the drive pattern by (i, i+offset).

    Raises:
        InputError: unknown name (the nearest one is suggested), a sensor file that declares
            something wrong, or an impossible offset.
        DataUnavailableError, DataCorruptError: no such recording, or one that cannot be read.
    """
    if is_file(name):
        nominal = _of_file(Path(name))
    elif name in sensors():
        nominal = _built(name)
    elif name in RECORDED_SETS:
        nominal = _built(RECORDED_SETS[name].sensor_name)
    else:
        raise unknown_name("sensor", name, sensors())
    if offset is None:
        return nominal
    pattern = offset_pattern(nominal.n_electrodes, offset)
    return replace(nominal, pattern=replace(pattern, magnitudes=nominal.pattern.magnitudes))


def _of_file(path: Path) -> Sensor:
    with suppress(OSError):
        known = path.resolve(strict=True)
        stat = known.stat()
        return _read(path, known, stat.st_mtime_ns, stat.st_size)
    return _read.__wrapped__(path, path, 0, 0)  # says what is wrong with it


@lru_cache(maxsize=32)  # every sample that is simulated asks for its sensor
def _read(path: Path, known: Path, changed_ns: int, size: int) -> Sensor:
    """The sensor of a file, read again when the file has changed."""
    del known, changed_ns, size
    return recorded_sensor(path) if is_recording(path.name) else read_sensor(path)


@cache
def _built(name: str) -> Sensor:
    return sensors()[name]()
