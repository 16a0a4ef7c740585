"""What a recorded set is; `RECORDED_SETS` lists every one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.sensors import Sensor, SensorBuilder

Truth = Literal["position", "classes", "none"]


@dataclass(frozen=True)
class RecordedFile:
    """One upstream file: its path inside the repository, its size and its SHA-256."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a recorded set, in the board's own units.

    Attributes:
        voltages: (n, M) frames, re-based on the common `reference` where every frame has its own
            untouched frame (v = reference + pressed - released), so that drift is removed alike
            for all methods.
        reference: (M,) the untouched sensor.
        samples: one row per frame; column `split` is "validation" or "test"; press positions are
            `x_m`, `y_m` [m] in the robot's frame, `depth_mm` where known.
        classes: (n, H, W) int8 truth: 0 background, -1 resistive, +1 conductive; None if unknown.
    """

    voltages: NDArray[np.float64]
    reference: NDArray[np.float64]
    samples: pd.DataFrame
    classes: NDArray[np.int8] | None = None


@dataclass(frozen=True, eq=False)
class RecordedSet:
    """Descriptor of a recorded set; the data stay at their public source.

    Attributes:
        name: registry name, also the name of its scenario.
        title: one line for listings.
        sensor_name, sensor: registry name and builder of its sensor.
        truth: what is known of each frame.
        repository, commit, files: the public GitHub source, fixed.
        licence, citation: as stated upstream.
        read: from the folder that holds the repository's files to a `Recording`.
    """

    name: str
    title: str
    sensor_name: str
    sensor: SensorBuilder
    truth: Truth
    repository: str
    commit: str
    files: tuple[RecordedFile, ...]
    licence: str
    citation: str
    read: Callable[[Path, Sensor], Recording]


RECORDED_SETS: dict[str, RecordedSet] = {}
