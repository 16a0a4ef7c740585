"""Round water tank measured by a Sciospec EIT instrument, offset 3, 10 kHz, 5 mA.

From upstream: 16 electrodes, drive pairs (i, i+3), complex potentials of 16 channels; the first 20
frames are the empty tank, then an insulating cup moves about. The cup enters after frame 63: frames
21 to 63 still equal the empty tank to within the noise and count as untouched here. Ours: radius
0.1 m, electrodes a quarter of their spacing wide, contact impedance 1e-3 Ohm*m2, electrode 0 on the
positive x axis, numbers counter-clockwise. Neither size nor orientation is published; the voltages
of an empty disc do not depend on them, up to a factor. The in-phase part is used, and the reference
is the mean of the first 10 frames.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    source,
    validation_every_fifth,
)
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import in_phase_differences, offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

_ELECTRODES, _OFFSET = 16, 3
_DRIVES = [(i, (i + _OFFSET) % _ELECTRODES) for i in range(_ELECTRODES)]
_EMPTY, _REFERENCE = 63, 10
_AMPLITUDE_LINE = 8  # drive current [A], counted from the line that says how long the header is
_FOLDER = "WaterTankData/20250212 13.21.48/setup/"
_SOURCE = source("Sciospec/sciospec_EIT_matlab_example", f"{_FOLDER}*.eit")


def _tank() -> Sensor:
    outline = Disc(0.1)
    electrodes = even_electrodes(outline, _ELECTRODES, outline.perimeter / 64, 1e-3)
    return Sensor("sciospec-tank", outline, electrodes, offset_pattern(_ELECTRODES, _OFFSET))


def read_eit(path: Path) -> NDArray[np.complex128]:
    """Potentials (16 drives, 16 channels) [V/A] of a `.eit` file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    # A line with the drive pair stands before every line of potentials.
    values = np.loadtxt(lines[int(lines[0]) + 1 :: 2]).reshape(_ELECTRODES, 32, 2)
    used = values[:, :_ELECTRODES]  # the other channels are not connected
    return np.asarray((used[..., 0] + 1j * used[..., 1]) / float(lines[_AMPLITUDE_LINE]))


def _read(folder: Path, sensor: Sensor) -> RecordedFrames:
    potentials = np.stack([read_eit(folder / file.path) for file in _SOURCE.files])
    frames = in_phase_differences(potentials, _DRIVES, sensor.pattern)
    number = np.array([int(Path(file.path).stem[-5:]) for file in _SOURCE.files])
    empty = number <= _EMPTY
    kept = number > _REFERENCE
    n = int(kept.sum())
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(n),
            "frame": number[kept],
            "touched": ~empty[kept],
            # The empty tank is one state; the cup never stands twice in one place.
            "state": np.where(empty, 0, number)[kept],
        }
    )
    return RecordedFrames(frames[kept], frames[~kept].mean(axis=0), samples)


SCIOSPEC_TANK = RecordedSet(
    name="sciospec-tank",
    title="round water tank, 16 electrodes, offset 3, an insulating cup moves",
    sensor_name="sciospec-tank",
    sensor=_tank,
    truth="none",
    source=_SOURCE,
    citation=(
        "Sciospec Scientific Instruments GmbH. sciospec_EIT_matlab_example, 2025, "
        "https://github.com/Sciospec/sciospec_EIT_matlab_example"
    ),
    reader=_read,
)
