"""Hydrogel disc e-skins of the HydrogelEIT project, pressed by a robot.

From upstream: opposition drive, the pattern table (checked against `lookup192.mat` and
`lookup32.mat`), magnitudes only, a skin 171 mm across (the scale of upstream's `calcEIT.m`),
presses within 70 mm of its centre. Ours: electrodes a quarter of their spacing wide, contact
impedance 1e-3 Ohm*m, electrode 0 at 281.25 degrees, numbers counter-clockwise in the robot's
coordinates.
The mirrored order contradicts the measured changes. The angle is uncertain: upstream draws
electrode 0 lowermost (270 degrees), the changes fit best at 272 or 287 degrees with or without the
leak described below. To score positions, a similarity transform between image and robot is fitted.

The boards' channels are uneven: between source and sink the values of a frame are several times
larger in the first half of the rim than in the second, so that a homogeneous disc hardly correlates
with the reference (0.19 for 16 electrodes, -0.03 for 8). Common-mode voltage that leaks into the
difference, V = U[a] - U[b] - 0.46 ((U[a] + U[b]) / 2 - U[sink]), explains most of it on both boards
(0.74 and 0.73), including the last values of each drive, which answer with the opposite sign.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    is_validation,
    source_of,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import DrivePattern, opposition_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

REPOSITORY = "DSHardman/HydrogelEIT"
CITATION = (
    "D. Hardman, T. George Thuruthel, F. Iida. Tactile perception in hydrogel-based robotic skins "
    "using data-driven electrical impedance tomography. Materials Today Electronics 4, 2023; data: "
    "https://github.com/DSHardman/HydrogelEIT"
)
DISTANCES_MM = {"A": 108.0, "B": 75.0, "C": 20.0}
"""Distance between the two probes of each multi-touch file."""

_RADIUS = 0.0855
_FIRST_ELECTRODE = np.deg2rad(281.25)


def check_lookup(folder: Path, pattern: DrivePattern) -> None:
    """Compare `pattern` with upstream's table, which numbers 32 half electrodes.

    Raises:
        DataCorruptError: they differ.
    """
    m = pattern.n_measurements
    path = folder / f"lookup{m}.mat"
    lookup = read_arrays(path, lookup=(m, 4))["lookup"]
    if not np.array_equal(lookup, pattern.table * (32 // (pattern.table.max() + 1))):
        raise DataCorruptError(f"{path} lists another pattern than the sensor: fetch it again.")


def rebased(
    pressed: NDArray[np.float64], released: NDArray[np.float64], samples: pd.DataFrame
) -> RecordedFrames:
    """Frames (n, M) on one reference: the median of the validation presses' released frames."""
    reference = np.median(released[is_validation(samples)], axis=0)
    return RecordedFrames(reference + pressed - released, reference, samples)


def _disc_skin(name: str, n_electrodes: int) -> Sensor:
    outline = Disc(_RADIUS)
    electrodes = even_electrodes(
        outline, n_electrodes, outline.perimeter / n_electrodes / 4, 1e-3,
        start=_RADIUS * _FIRST_ELECTRODE,
    )  # fmt: skip
    # Sixteen electrodes resolve far less than 80 x 80; 3.6 mm pixels keep real time in reach.
    return Sensor(
        name, outline, electrodes, opposition_pattern(n_electrodes), image_shape=(48, 48),
        conductivity_range=(0.05, 1.0),
    )  # fmt: skip


def _read_presses(file: str, folder: Path, sensor: Sensor) -> RecordedFrames:
    check_lookup(folder, sensor.pattern)
    shape = (500, sensor.n_measurements)
    mat = read_arrays(folder / file, positions=(500, 3), responsedowns=shape, responseups=shape)
    x, y, depth = mat["positions"].T
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(500),
            "x_m": x,
            "y_m": y,
            "depth_mm": np.round(depth * 1e3, 3),
            "touched": True,
        }
    )
    return rebased(mat["responsedowns"], mat["responseups"], samples)


def _read_multitouch(folder: Path, sensor: Sensor) -> RecordedFrames:
    check_lookup(folder, sensor.pattern)
    pressed, released, distances = [], [], []
    for part, distance in DISTANCES_MM.items():
        n = 10 if part == "C" else 8
        shape = (n, sensor.n_measurements)
        path = folder / f"Extracted/MultiTouch/multitouch{part}.mat"
        mat = read_arrays(path, responsedowns=shape, responseups=shape)
        pressed.append(mat["responsedowns"])
        released.append(mat["responseups"])
        distances += [distance] * n
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(len(distances)),
            "probe_distance_mm": distances,
            "touched": True,
            "state": np.unique(distances, return_inverse=True)[1],
        }
    )
    return rebased(np.concatenate(pressed), np.concatenate(released), samples)


OHMC16 = RecordedSet(
    name="ohmc16",
    title="hydrogel disc skin, 16 electrodes, 500 robot presses of 10, 15 and 20 mm",
    sensor_name="ohmc16",
    sensor=partial(_disc_skin, "ohmc16", 16),
    truth="position",
    source=source_of(REPOSITORY, "Extracted/ohmc16.mat", "lookup192.mat"),
    citation=CITATION,
    reader=partial(_read_presses, "Extracted/ohmc16.mat"),
)

OHMC8 = RecordedSet(
    name="ohmc8",
    title="hydrogel disc skin, 8 electrodes, 500 robot presses of 10, 15 and 20 mm",
    sensor_name="ohmc8",
    sensor=partial(_disc_skin, "ohmc8", 8),
    truth="position",
    source=source_of(REPOSITORY, "Extracted/ohmc8.mat", "lookup32.mat"),
    citation=CITATION,
    reader=partial(_read_presses, "Extracted/ohmc8.mat"),
)

MULTITOUCH = RecordedSet(
    name="hydrogel-multitouch",
    title="hydrogel disc skin, 16 electrodes, two probes 108, 75 and 20 mm apart",
    sensor_name="ohmc16",
    sensor=partial(_disc_skin, "ohmc16", 16),
    truth="none",
    source=source_of(
        REPOSITORY,
        "lookup192.mat",
        *(f"Extracted/MultiTouch/multitouch{part}.mat" for part in DISTANCES_MM),
    ),
    citation=CITATION,
    reader=_read_multitouch,
)
