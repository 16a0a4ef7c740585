"""Recordings of one's own as recorded sets, beside the public ones."""

import hashlib
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.descriptors import (
    RecordedFile,
    RecordedFrames,
    RecordedSet,
    Source,
    Truth,
    validation_every_fifth,
)
from eitbench.scenarios.recordings.files.recording_file import Condition, Content, read_file
from eitbench.scenarios.recordings.frames import impossible, peak
from eitbench.scenarios.sensors.sensor import Sensor


def is_recording(name: str) -> bool:
    """True if `name` is the path of a recording (.h5), not the name of a public set."""
    return name.endswith(".h5")


def sha256_of(path: Path) -> str:
    """SHA-256 (hex) of the file at `path`."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def own_set(path: Path) -> RecordedSet:
    """Return the recording at `path` as a recorded set.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
        DataCorruptError: no recording, or a damaged one.
        InputError: it has no labels or no reference, so that no method can be evaluated on it.
    """
    try:
        known = path.resolve(strict=True)
        stat = known.stat()
    except OSError as error:
        raise UnreadableError(f"Cannot read the recording {path}: {error.strerror}.") from error
    return _own_set(known, stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=32)
def _own_set(path: Path, changed_ns: int, size: int) -> RecordedSet:
    """`own_set`, read again when the file has changed."""
    content = _usable(path)
    board = "an emulated board" if content.emulated else f"the board {content.board}"
    return RecordedSet(
        name=path.stem,
        title=f"own recording with {board}, touches: {len(content.labels)}",
        sensor_name=str(path),
        sensor=partial(_same, content.sensor),
        truth=_truth(content),
        source=Source("", "", "", (RecordedFile(path.name, size, sha256_of(path)),)),
        citation="",
        reader=partial(_read, path),
        own=path,
        emulated=content.emulated,
    )


def _same(sensor: Sensor) -> Sensor:
    return sensor


def _truth(content: Content) -> Truth:
    places = content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    return "position" if np.isfinite(places).all() else "none"


def undamaged(path: Path) -> tuple[Content, Condition]:
    """Read the recording at `path` as `read_file` does, unless it was damaged.

    Frames may be missing at the end of a file that was not closed.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
        DataCorruptError: no recording, or a damaged one.
    """
    content, condition = read_file(path)
    problem = damage(condition)
    if not problem and outside(content):
        problem = "a label or the reference lies outside it"
    if problem:
        raise DataCorruptError(f"{path} is damaged, so that it is not used: {problem}.")
    return content, condition


def _usable(path: Path) -> Content:
    """The content of the file at `path`, if methods can be evaluated on it."""
    content, _ = undamaged(path)
    for name, marked in (("labels", content.labels), ("reference frames", content.reference)):
        if not len(marked):
            raise InputError(f"{path} has no {name}, so it is no set: record with --guided.")
    if len(wrong := impossible(content.values)):
        raise DataCorruptError(
            f"{path} is not used: frame {wrong[0]} holds {peak(content.values[wrong[0]])}."
        )
    if (away := off_sensor(content)).size:
        x, y = 1e3 * content.labels.loc[away[0], ["x_m", "y_m"]]
        raise DataCorruptError(
            f"{path} is not used: label {away[0]} at ({x:.4g}, {y:.4g}) mm is outside the sensor."
        )
    return content


def off_sensor(content: Content) -> NDArray[np.intp]:
    """The labels that name a place outside the sensor, as their numbers."""
    places = content.labels[["x_m", "y_m"]].to_numpy(dtype=np.float64)
    inside = content.sensor.outline.contains(*places.T)
    return np.flatnonzero(~inside & np.isfinite(places).any(axis=1))


def damage(condition: Condition) -> str:
    """Description of a change after the recording was written; "" for none."""
    if condition.damaged:
        count = len(condition.damaged)
        more = f" (and {count - 1} more)" if count > 1 else ""
        return f"the checksum of frame {condition.damaged[0]}{more} is wrong"
    if condition.complete and not condition.sealed:
        return "its labels, events or header were changed after it was closed"
    return ""


def outside(content: Content) -> bool:
    """True if a label or the reference names frames that are not there."""
    first, last = content.labels["first"].to_numpy(), content.labels["last"].to_numpy()
    rows = np.concatenate([first, last, content.reference])
    return bool((rows < 0).any() or (rows >= len(content)).any() or (last < first).any())


def _read(path: Path, folder: Path, sensor: Sensor) -> RecordedFrames:
    del folder, sensor  # the file knows its own
    content = _usable(path)
    labels = content.labels
    rows = zip(labels["first"], labels["last"], strict=True)
    samples = pd.DataFrame(
        {
            "split": validation_every_fifth(len(labels)),
            **{name: labels[name] for name in ("x_m", "y_m", "depth_mm")},
            "touched": True,
        }
    )
    if (labels["state"] != "").all():
        samples["state"] = labels["state"]
    return RecordedFrames(
        np.stack([content.values[first : last + 1].mean(axis=0) for first, last in rows]),
        content.values[content.reference].mean(axis=0),
        samples,
    )
