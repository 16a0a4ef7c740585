"""Rectangular water tank of the imt-jku EIT app, a cylinder at four positions, four drive patterns.

From upstream: 16 electrodes, four from each corner on, clockwise from the upper-left corner of a
40 x 80 rectangle (`getWaterModel` in `Model.m`), drive pairs as in the files, all differences of
neighbours that spare the driven electrodes. Ours: millimetres (upstream gives no unit), electrodes
2.5 mm wide, contact impedance 1e-4 Ohm*m2. No empty tank was recorded: as upstream, the mean of the
three repeats at position 1 is the reference. The in-phase part is used; with adjacent drive it is
small and half of the signal is out of phase, so those frames agree less well with a model.
"""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    Source,
    source,
    validation_every_fifth,
)
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.patterns import Drives, in_phase_differences, pair_pattern
from eitbench.scenarios.sensors.sensor import Electrode, Sensor

_ELECTRODES = 16
_WIDTH, _HEIGHT = 0.04, 0.08
_PREFIX_BYTES = 9  # channel group, source, sink, frequency row (2), timestamp (4)
_NAME = re.compile(r"_(\d)-\((\d)\)\.txt$")

_DIAGONAL = [
    *((2 + k, 16 - k) for k in range(7)),
    *((14 + k, 12 - k) for k in range(3)),
    *((1 + k, 9 - k) for k in range(4)),
]
_OPPOSITE = [*((1 + k, 13 - k) for k in range(5)), (5, 1), *((6 + k, 16 - k) for k in range(4))]
_NUMBERED = {  # electrodes numbered from 1, as upstream
    "adjacent": [(k % _ELECTRODES + 1, k) for k in range(1, _ELECTRODES + 1)],
    "diagonal": _DIAGONAL,
    "hybrid": _DIAGONAL + _OPPOSITE,
    "opposite": _OPPOSITE,
}
DRIVES: dict[str, Drives] = {
    name: [(src - 1, sink - 1) for src, sink in pairs] for name, pairs in _NUMBERED.items()
}
"""(src, sink) of every injection of each drive pattern."""


def _rim() -> list[float]:
    """Arc lengths [m] of the electrodes: clockwise from the upper-left corner."""
    corner = 2 * _WIDTH + _HEIGHT
    steps = [_WIDTH / 4] * 4 + [_HEIGHT / 4] * 4 + [_WIDTH / 4] * 4 + [_HEIGHT / 4] * 3
    walked = np.concatenate([[0.0], np.cumsum(steps)])
    return [float(s) for s in (corner - walked) % (2 * (_WIDTH + _HEIGHT))]


def _tank(drive: str) -> Sensor:
    electrodes = tuple(Electrode(s, 0.0025, 1e-4) for s in _rim())
    neighbours = [(j, (j + 1) % _ELECTRODES) for j in range(_ELECTRODES)]
    return Sensor(
        f"jku-tank-{drive}",
        rectangle(_WIDTH, _HEIGHT),
        electrodes,
        pair_pattern(DRIVES[drive], neighbours),
        image_shape=(80, 40),
    )


def read_txt(path: Path) -> NDArray[np.complex128]:
    """Potentials (drives, 16) [V/A] of a measurement file: one line of bytes per injection."""
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    current = float(header.split(",")[0].removeprefix("Current:"))
    raw = b"".join(bytes.fromhex(line)[_PREFIX_BYTES:] for line in lines)
    pairs = np.frombuffer(raw, ">f4").astype(np.float64).reshape(-1, _ELECTRODES, 2)
    return np.asarray((pairs[..., 0] + 1j * pairs[..., 1]) / current)


def _read(files: Source, drive: str, folder: Path, sensor: Sensor) -> RecordedFrames:
    drives = DRIVES[drive]
    potentials = np.stack([read_txt(folder / file.path) for file in files.files])
    frames = in_phase_differences(potentials, drives, sensor.pattern)
    labels = [_NAME.search(file.path) for file in files.files]
    position, repeat = np.array([[int(v) for v in m.groups()] for m in labels if m]).T
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(len(frames)),
            "position": position,
            "repeat": repeat,
            "touched": position > 1,
            "state": position,
        }
    )
    return RecordedFrames(frames, frames[position == 1].mean(axis=0), samples)


def _recorded_set(drive: str) -> RecordedSet:
    files = source("imt-jku/EIT-Sciospec", f"Sample_Measurements/{drive.capitalize()}/*")
    return RecordedSet(
        name=f"jku-tank-{drive}",
        title=f"rectangular water tank, 16 electrodes, {drive} drive, a cylinder at 4 positions",
        sensor_name=f"jku-tank-{drive}",
        sensor=partial(_tank, drive),
        truth="none",
        source=files,
        citation=(
            "A. Hofer, Institute of Measurement Technology, JKU Linz. EIT Measurement App, 2024, "
            "https://github.com/imt-jku/EIT-Sciospec"
        ),
        reader=partial(_read, files, drive),
    )


JKU_TANKS = tuple(_recorded_set(drive) for drive in DRIVES)
