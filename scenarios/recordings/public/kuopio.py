"""Water tank of the Kuopio Tomography Challenge 2023 (KTC2023), with truth images.

From upstream: 32 electrodes covering half of the rim, 76 injections between even electrodes
(`Inj`), 31 differences of neighbours each (`Mpat`, driven electrodes included), an empty tank
(`ref.mat`) and four targets as 256 x 256 images, row 0 at the top. Ours: radius 0.115 m, contact
impedance 1e-5 Ohm*m2, `Inj` read as mA. Electrode 0 is at the top, numbers run counter-clockwise:
of all rotations and both directions only this one makes one-step images agree with all four truth
images (best at 87 to 90 degrees, mean correlation 0.61; the other direction reaches 0.39).

The evaluation data of the challenge are seven levels of three targets; level k lacks all values
that concern the first 2 (k - 1) electrodes (NaN in the files). Its organisers published four
targets to train with, `ktc2023`; reduced alike, they are the validation split of every level. All
truths are public now.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.arrays import nearest_pixels
from eitbench.scenarios.recordings.descriptors import (
    RecordedFrames,
    RecordedSet,
    source,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.matlab import read_arrays
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import DrivePattern, pair_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

LEVELS = 7
"""Levels of difficulty of the challenge."""
_ELECTRODES, _DIFFERENCES, _TARGETS = 32, 31, 4
_EVALUATION = "KTC2023/EvaluationData"
_CLASS = np.array([0, -1, 1], dtype=np.int8)  # upstream: 0 water, 1 resistive, 2 conductive


def injections() -> list[tuple[int, int]]:
    """(src, sink) of the 76 injections: the ring of even electrodes, then all to 0, 8, 16, 24."""
    even = range(0, _ELECTRODES, 2)
    ring = [(i, (i + 2) % _ELECTRODES) for i in even]
    against = [(i, sink) for sink in (0, 8, 16, 24) for i in even if i != sink]
    return ring + against


def _pattern() -> DrivePattern:
    return pair_pattern(injections(), [(k, k + 1) for k in range(_DIFFERENCES)], driven=True)


def tank(level: int = 1) -> Sensor:
    """The tank; a level of the challenge lacks what concerns the first 2 (level - 1) electrodes.

    These stay in the water, so that they stay in the model.
    """
    outline = Disc(0.115)
    electrodes = even_electrodes(
        outline, _ELECTRODES, outline.perimeter / 64, 1e-5, start=outline.perimeter / 4
    )
    table = _pattern().table
    kept = table[(table >= 2 * (level - 1)).all(axis=1)]
    return Sensor("ktc2023", outline, electrodes, DrivePattern(kept))


def _frame(path: Path, current: str, voltage: str) -> NDArray[np.float64]:
    """One frame (2356,) [V/A], each value divided by the current of its injection."""
    mat = read_arrays(path, current, voltage)
    amplitude = np.abs(mat[current]).max(axis=0)
    per_injection = mat[voltage].reshape(-1, _DIFFERENCES)
    return np.ravel(per_injection / (amplitude[:, None] * 1e-3))


def resampled(image: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """The nearest pixel of `image`, row 0 at the top, for each pixel (H, W) of the sensor's grid.

    The image fills the outline's bounding box, as the grid does.
    """
    return nearest_pixels(image[::-1], sensor.image_shape)


def _level(level: int) -> RecordedSet:
    """The evaluation targets of a level, with the four of `ktc2023` to choose parameters by."""

    def sensor() -> Sensor:
        return replace(tank(level), name=f"ktc2023-level{level}")

    def kept(frame: NDArray[np.float64]) -> NDArray[np.float64]:
        return frame[(_pattern().table >= 2 * (level - 1)).all(axis=1)]

    def read(folder: Path, data: str, truths: str, count: int, split: str) -> RecordedFrames:
        numbers = range(1, count + 1)
        frames = [kept(_frame(folder / data / f"data{k}.mat", "Inj", "Uel")) for k in numbers]
        found = [read_arrays(folder / truths.format(k), "truth")["truth"] for k in numbers]
        samples = pd.DataFrame(
            {"split": split, "target": [f"{split} {k}" for k in numbers], "touched": True}
        )
        return RecordedFrames(
            np.stack(frames),
            kept(_frame(folder / data / "ref.mat", "Injref", "Uelref")),
            samples,
            np.stack([_CLASS[truth[::-1].astype(int)] for truth in found]),
        )

    def evaluation(folder: Path, _: Sensor) -> RecordedFrames:
        folder = folder / _EVALUATION
        truths = f"GroundTruths/level_{level}/{{}}_true.mat"
        return read(folder, f"evaluation_datasets/level{level}", truths, 3, "test")

    def training(folder: Path, _: Sensor) -> RecordedFrames:
        return read(folder, "TrainingData", "GroundTruths/true{}.mat", _TARGETS, "validation")

    files = [f"{_EVALUATION}/*/level{level}/*.mat", f"{_EVALUATION}/*/level_{level}/*.mat"]
    return replace(
        KTC2023,
        name=f"ktc2023-level{level}",
        title=f"Kuopio Tomography Challenge 2023, level {level} of {LEVELS}: "
        f"{_ELECTRODES - 2 * (level - 1)} of {_ELECTRODES} electrodes, 3 targets (open test)",
        sensor_name=f"ktc2023-level{level}",
        sensor=sensor,
        source=source("LJK666666666/EIT_KTC2023_4", *files),
        reader=evaluation,
        validation=replace(KTC2023, sensor=sensor, reader=training),
    )


def _read(folder: Path, sensor: Sensor) -> RecordedFrames:
    reference = _frame(folder / "TrainingData/ref.mat", "Injref", "Uelref")
    frames, classes = [], []
    for k in range(1, _TARGETS + 1):
        frames.append(_frame(folder / f"TrainingData/data{k}.mat", "Inj", "Uel"))
        truth = read_arrays(folder / f"GroundTruths/true{k}.mat", "truth")["truth"]
        classes.append(_CLASS[resampled(truth, sensor).astype(int)])
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(_TARGETS),
            "target": [f"data{k}" for k in range(1, _TARGETS + 1)],
            "touched": True,
        }
    )
    return RecordedFrames(np.stack(frames), reference, samples, np.stack(classes))


KTC2023 = RecordedSet(
    name="ktc2023",
    title="Kuopio Tomography Challenge 2023, water tank, 32 electrodes, 4 targets with images",
    sensor_name="ktc2023",
    sensor=tank,
    truth="classes",
    source=source("CUQI-DTU/KTC2023-CUQI1", "TrainingData/*.mat", "GroundTruths/*.mat"),
    citation=(
        "M. Räsänen et al. Kuopio Tomography Challenge 2023: open electrical impedance tomographic "
        "dataset. Zenodo, doi:10.5281/zenodo.8252370"
    ),
    reader=_read,
)
KTC2023_LEVELS = tuple(_level(level) for level in range(1, LEVELS + 1))
