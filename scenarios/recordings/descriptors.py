"""Descriptors of recorded sets, and the frames that their readers return."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.sensors.sensor import Sensor, SensorBuilder


@dataclass(frozen=True)
class RecordedFile:
    """One upstream file: its path inside the repository, its size and its SHA-256."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Source:
    """Files of one public GitHub repository at one commit.

    Attributes:
        repository: `owner/name`.
        commit: 40 hexadecimal digits.
        licence: as stated upstream.
    """

    repository: str
    commit: str
    licence: str
    files: tuple[RecordedFile, ...]

    def url(self, file: RecordedFile) -> str:
        """Public address of `file`."""
        return (
            f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{quote(file.path)}"
        )


@cache
def _listing() -> Any:
    text = resources.files("eitbench.scenarios.recordings").joinpath("sources.json").read_text()
    return json.loads(text)


def source(repository: str, *patterns: str) -> Source:
    """The files of `repository` whose paths match any of `patterns`, such as "data/*.mat"."""
    entry = _listing()[repository]
    files = tuple(
        RecordedFile(**file)
        for file in entry["files"]
        if any(fnmatchcase(file["path"], pattern) for pattern in patterns)
    )
    return Source(repository, entry["commit"], entry["licence"], files)


Truth = Literal["position", "classes", "none"]

LOADS = ("force_N", "pressure_pa")
"""Columns of samples: what presses, where it was measured."""
PLACES = (("x_m", "y_m"), *((f"x{k}_m", f"y{k}_m") for k in range(2, 11)))
"""Columns of the places of as many contacts as a touch may have."""


@dataclass(frozen=True, eq=False)
class RecordedFrames:
    """The frames of a recorded set.

    Voltages are V/A where the source states its drive current, else the board's own units; a
    method calibrates the gain from the reference frame.

    Attributes:
        voltages: (n, M) frames, re-based on the common `reference` where every frame has its own
            reference frame (v = reference + pressed - released), so that drift is removed alike
            for all methods.
        reference: (M,) the untouched sensor (or the state that stands for it, see the reader).
        samples: one row per frame. Column `split` is "validation" or "test". Where known: `x_m`,
            `y_m` [m] and `depth_mm` of a press in the robot's coordinates; `force_N`, of all
            contacts together, and `pressure_pa`; `touched`, False for frames of the empty sensor;
            `state`, equal for frames that repeat one state. Where some touches have several
            contacts: `contacts`, their number, and `x2_m`, `y2_m`, ... of the second and further.
        classes: (n, h, w) int8 truth: 0 background, -1 resistive, +1 conductive; None if unknown.
            Its pixels may be finer than the sensor's.
        modelled_reference: `reference` is the nominal sensor's, as only differences were measured.
    """

    voltages: NDArray[np.float64]
    reference: NDArray[np.float64]
    samples: pd.DataFrame
    classes: NDArray[np.int8] | None = None
    modelled_reference: bool = False

    def without_test(self) -> "RecordedFrames":
        """The same without the frames of the test split."""
        kept = (self.samples["split"] != "test").to_numpy()
        return replace(
            self,
            voltages=self.voltages[kept],
            samples=self.samples[kept].reset_index(drop=True),
            classes=None if self.classes is None else self.classes[kept],
        )

    def after(self, others: "RecordedFrames") -> "RecordedFrames":
        """Frames of the same sensor, `others` first; the reference frame is this one's."""
        known = None
        if self.classes is not None and others.classes is not None:
            known = np.concatenate([others.classes, self.classes])
        return replace(
            self,
            voltages=np.concatenate([others.voltages, self.voltages]),
            samples=pd.concat([others.samples, self.samples], ignore_index=True),
            classes=known,
        )


@dataclass(frozen=True, eq=False)
class RecordedSet:
    """Descriptor of a recorded set; the data stay at their public source, or in one's own file.

    Attributes:
        name: registry name, also the name of its scenario.
        title: one line for listings.
        sensor_name, sensor: registry name and builder of its sensor; needs no data.
        truth: kind of truth that is known of each frame.
        source: the public repository at a fixed commit, its licence and the files of this set.
        citation: of the publication.
        reader: from the folder that holds the repository's files to a `RecordedFrames`.
        own: the file of a recording of one's own, which has no public source.
        emulated: no real sensor was measured.
        validation: the set, of another source, whose frames are the validation split of this one.
    """

    name: str
    title: str
    sensor_name: str
    sensor: SensorBuilder
    truth: Truth
    source: Source
    citation: str
    reader: Callable[[Path, Sensor], RecordedFrames]
    own: Path | None = None
    emulated: bool = False
    validation: "RecordedSet | None" = None

    @property
    def repository(self) -> str:
        """`owner/name` of the public repository."""
        return self.source.repository

    @property
    def files(self) -> tuple[RecordedFile, ...]:
        """The upstream files of this set."""
        return self.source.files

    def read(self, folder: Path) -> RecordedFrames:
        """The frames in `folder`, which holds the repository's files, verified, at their paths.

        Raises:
            DataCorruptError: frames that are not finite, or of another shape than the sensor's.
        """
        nominal = self.sensor()
        recording = self.reader(folder, nominal)
        frames = np.vstack([recording.reference, recording.voltages])
        shape = (1 + len(recording.samples), nominal.n_measurements)
        if frames.shape != shape or not np.isfinite(frames).all():
            raise DataCorruptError(
                f"The frames of {self.name!r} are not {shape} finite numbers: fetch it again."
            )
        return recording


def validation_every_fifth(n: int) -> list[str]:
    """Column `split` of `n` samples: the first of every five is "validation", the rest "test".

    The rule looks at the running number only, never at the data, and spreads both splits evenly
    over the time of the recording, so that drift and ageing touch them alike.
    """
    return ["test" if k % 5 else "validation" for k in range(n)]


def contact_places(samples: pd.DataFrame) -> NDArray[np.float64]:
    """Places (n, k, 2) [m] of up to k contacts of each sample; NaN where it has fewer."""
    known = [list(names) for names in PLACES if set(names) <= set(samples)]
    return np.stack([samples[names].to_numpy(dtype=np.float64) for names in known], axis=1)


def is_validation(samples: pd.DataFrame) -> NDArray[np.bool_]:
    """(n,): the rows of the validation split."""
    return (samples["split"] == "validation").to_numpy(dtype=bool)
