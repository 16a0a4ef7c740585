"""Small round water tank of the PyEIDORS project, metal and plastic targets beside electrodes.

From upstream: radius 25 mm, 16 electrodes, adjacent drive, electrode 1 at the top and numbers
clockwise, values in EIDORS' rotating order: for drive (i, i+1) the pairs (i+2, i+3), (i+3, i+4) and
so on. A file holds two frames, the empty tank and the targets, each as real and imaginary part; the
folder names the targets. Ours: electrodes half of their spacing wide, contact impedance 1e-5
Ohm*m2, and the polarity U[i+3] - U[i+2], which the signs show. The real part is used. Files are
divided by their drive current, taken from the file name.
"""

import re
from pathlib import Path, PurePosixPath

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    source,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.differences import rebased
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import ring_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

_ELECTRODES = 16
# The recording of 2025 was made in another set-up and does not say what stood in the tank.
_SOURCE = source("CBZ199671/PyEIDORS", "*/2026-03-14_latest_tank_data/*")


def _tank() -> Sensor:
    outline = Disc(0.025)
    electrodes = even_electrodes(
        outline, _ELECTRODES, outline.perimeter / 32, 1e-5,
        start=outline.perimeter / 4, clockwise=True,
    )  # fmt: skip
    pattern = ring_pattern(_ELECTRODES, 1, -1, rotating=True)
    return Sensor("pyeidors-tank", outline, electrodes, pattern)


def read_csv(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Real parts (208,) [V/A] of the empty tank and of the targets."""
    values = np.loadtxt(path, delimiter=",")
    (current,) = re.findall(r"_(\d+)uA_", path.name)
    amplitude = float(current) * 1e-6
    return values[:, 0] / amplitude, values[:, 2] / amplitude


def targets(path: str) -> str:
    """The targets named by the folder of `path`, such as "1 metal, 5 plastic"."""
    found = re.findall(r"electrode(\d+)_(metal|plastic)", PurePosixPath(path).parent.name)
    return ", ".join(f"{int(number)} {kind}" for number, kind in found)


def _read(folder: Path, sensor: Sensor) -> RecordedFrames:
    del sensor  # every file has the same fixed shape
    pairs = [read_csv(folder / file.path) for file in _SOURCE.files]
    empty, filled = (np.stack(frames) for frames in zip(*pairs, strict=True))
    named = [targets(file.path) for file in _SOURCE.files]
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(len(named)),
            "targets": named,
            "touched": True,
            "state": np.unique(named, return_inverse=True)[1],
        }
    )
    return rebased(filled, empty, samples)


PYEIDORS_TANK = RecordedSet(
    name="pyeidors-tank",
    title="round water tank of radius 25 mm, 16 electrodes, adjacent, metal and plastic targets",
    sensor_name="pyeidors-tank",
    sensor=_tank,
    truth="none",
    source=_SOURCE,
    citation="B. Chen. PyEIDORS, 2026, https://github.com/CBZ199671/PyEIDORS",
    reader=_read,
)
