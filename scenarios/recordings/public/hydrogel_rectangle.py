"""Rectangular hydrogel e-skins of the HydrogelEIT project, 130 x 60 mm.

From upstream: the pressed area, the pattern (as for the discs), the robot's coordinates, which
start at the lower-left corner. Ours: the pressed area taken for the whole skin; electrodes every
23.75 mm (16) or 47.5 mm (8) along the rim, counter-clockwise, the first 17.5 mm from the lower-left
corner, each a third of its spacing wide, contact impedance 1e-3 Ohm*m. This layout (for 8
electrodes three on each long side, one on each short side) is where the 10,000 presses show each
drive pair to be most sensitive; nothing confirms it for 16. In the 8-electrode recording several
electrodes conduct badly: a third of the values are saturated, drives (0, 4) and (1, 5) show little.

Rows of `response` alternate; the second of each pair is the pressed one, as in upstream's
`ExtractResponses.m`, and it varies more from press to press.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    is_validation,
    source_of,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.recordings.public.hydrogel import (
    CITATION,
    REPOSITORY,
    check_lookup,
    rebased,
)
from eitbench.scenarios.sensors.outlines import rectangle
from eitbench.scenarios.sensors.patterns import opposition_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

_FOLDER = "Extracted/Rectangle"
_RANDOM = f"{_FOLDER}/random_f_d_8_10k.mat"
_FIXED = f"{_FOLDER}/fixed_f_d_16_200.mat"
_REPEATS = f"{_FOLDER}/repeats_r_s_16_50_5.mat"


def _skin(name: str, n_electrodes: int) -> Sensor:
    outline = rectangle(0.13, 0.06)
    width = outline.perimeter / n_electrodes / 3
    electrodes = even_electrodes(outline, n_electrodes, width, 1e-3, start=0.0175)
    pattern = opposition_pattern(n_electrodes)
    return Sensor(
        name, outline, electrodes, pattern, image_shape=(48, 104), conductivity_range=(0.05, 1.0)
    )


def _read_presses(folder: Path, sensor: Sensor) -> RecordedFrames:
    check_lookup(folder, sensor.pattern)
    mat = read_arrays(
        folder / _RANDOM, positions=(10000, 2), response=(20000, sensor.n_measurements)
    )
    x, y = mat["positions"].T
    samples = pd.DataFrame(
        {"split": validation_every_fifth(10000), "x_m": x, "y_m": y, "touched": True}
    )
    return rebased(mat["response"][1::2], mat["response"][::2], samples)


def _read_fixed(folder: Path, sensor: Sensor) -> RecordedFrames:
    """Read released and pressed frames as measured: not re-based, since their drift matters."""
    check_lookup(folder, sensor.pattern)
    frames = read_arrays(folder / _FIXED, response=(400, sensor.n_measurements))["response"]
    touched = np.arange(400) % 2 == 1
    # Both frames of a press share its split.
    split = np.repeat(validation_every_fifth(200), 2)
    samples = pd.DataFrame({"split": split, "touched": touched, "state": touched.astype(int)})
    return _without_own_reference(frames, samples, released=~touched)


def _read_repeats(folder: Path, sensor: Sensor) -> RecordedFrames:
    """Pressed frames only: the reference is their median, since no released frame was recorded."""
    check_lookup(folder, sensor.pattern)
    mat = read_arrays(
        folder / _REPEATS, positions=(50, 3), responses=(50, 5, sensor.n_measurements)
    )
    press = np.repeat(np.arange(50), 5)
    x, y, depth = mat["positions"][press].T
    samples = pd.DataFrame(
        {
            "split": np.repeat(validation_every_fifth(50), 5),
            "x_m": x,
            "y_m": y,
            "depth_mm": np.round(depth * 1e3, 3),
            "touched": True,
            "state": press,
        }
    )
    frames = mat["responses"].reshape(250, -1)
    return _without_own_reference(frames, samples, released=np.ones(250, dtype=bool))


def _without_own_reference(
    frames: np.ndarray, samples: pd.DataFrame, released: np.ndarray
) -> RecordedFrames:
    reference = np.median(frames[released & is_validation(samples)], axis=0)
    return RecordedFrames(frames, reference, samples)


RECTANGLE = RecordedSet(
    name="hydrogel-rectangle",
    title="rectangular hydrogel skin, 8 electrodes, 10,000 robot presses",
    sensor_name="hydrogel-rectangle",
    sensor=partial(_skin, "hydrogel-rectangle", 8),
    truth="position",
    source=source_of(REPOSITORY, _RANDOM, "lookup32.mat"),
    citation=CITATION,
    reader=_read_presses,
)

FIXED_PRESS = RecordedSet(
    name="hydrogel-fixed",
    title="rectangular hydrogel skin, 16 electrodes, one press repeated 200 times",
    sensor_name="hydrogel-rectangle16",
    sensor=partial(_skin, "hydrogel-rectangle16", 16),
    truth="none",
    source=source_of(REPOSITORY, _FIXED, "lookup192.mat"),
    citation=CITATION,
    reader=_read_fixed,
)

REPEATS = RecordedSet(
    name="hydrogel-repeats",
    title="rectangular hydrogel skin, 16 electrodes, 50 presses repeated 5 times",
    sensor_name="hydrogel-rectangle16",
    sensor=partial(_skin, "hydrogel-rectangle16", 16),
    truth="none",
    source=source_of(REPOSITORY, _REPEATS, "lookup192.mat"),
    citation=CITATION,
    reader=_read_repeats,
)
