"""Recordings to and from other formats: CSV, MATLAB, HDF5 and the public recorded sets."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.recorder import Recorder, check_new
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import is_recording, recorded_set
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.files.csv_mat import (
    read_csv,
    read_mat_recording,
    without_times,
    write_csv,
    write_mat,
)
from eitbench.scenarios.recordings.files.own import undamaged
from eitbench.scenarios.recordings.files.recording_file import Content, label_table
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.storage.try_reading import try_reading

_OF_HEADER = ("firmware", "emulated", "started", "differences")
_READERS = {".csv": read_csv, ".mat": read_mat_recording}


def export_recording(path: Path, to: Path) -> str:
    """Write the recording at `path` to the new file `to`; of one that was cut off, what is intact.

    Args:
        path: of the recording.
        to: a name that ends in .csv, .mat or .h5.

    Returns:
        How many frames were written, and what is missing, in sentences.

    Raises:
        InputError: another ending, `to` exists already, or there are no frames.
        UnreadableError, DataCorruptError: the recording cannot be read, or is damaged.
    """
    writers = {".csv": write_csv, ".mat": write_mat, ".h5": write_recording}
    if to.suffix not in writers:
        raise InputError(f"A recording is exported to .csv, .mat or .h5, not to {to.name!r}.")
    content, condition = undamaged(path)
    if to.exists():
        raise InputError(f"{to} exists already and is never overwritten: name another file.")
    if not len(content):
        raise InputError(f"{path} holds no frames: there is nothing to export.")
    writers[to.suffix](content, to)
    written = f"{len(content)} frames are in {to}."
    if condition.complete:
        return written
    return f"{written} {path} was not closed: what followed them is lost."


def import_recording(source: str, to: Path, sensor: Sensor | None = None) -> int:
    """Make the new recording `to` of `source`; the number of its frames.

    Args:
        source: path of a .csv or .mat file, or name of a public recorded set.
        to: a name that ends in .h5.
        sensor: that the frames were measured on, for files that do not say.

    Raises:
        InputError: a sensor where none is needed or none where one is, an unknown source, or `to`
            exists already.
        UnreadableError, DataUnavailableError, DataCorruptError: the source cannot be read, or is
            not what it should be.
    """
    check_new(to)
    if is_recording(source):
        raise InputError(f"{source} is a recording already: use it as it is.")
    path, reader = Path(source), _READERS.get(Path(source).suffix)
    if reader is None:
        content = _public(source, sensor)
    else:
        try_reading(path, reader, path, sensor)
        content = reader(path, sensor)
    write_recording(content, to)
    return len(content)


def write_recording(content: Content, to: Path) -> None:
    """Write `content` to the new recording `to`.

    Raises:
        InputError: `to` exists already.
        RecorderError: it cannot be written.
    """
    named = {name: getattr(content, name) for name in _OF_HEADER}
    columns = (content.number.tolist(), content.time_s.tolist(), content.received_s.tolist())
    with Recorder(to, content.sensor, content.board, **named) as recorder:
        for frame in zip(*columns, content.values, strict=True):
            recorder.append(Frame(*frame))
        for row in content.reference.tolist():
            recorder.mark_reference(row, row)
        for label in content.labels.to_dict("records"):
            recorder.label(**{str(name): value for name, value in label.items()})
        for event in content.events.to_dict("records"):
            recorder.event(event["text"], event["time_s"])


def _public(name: str, sensor: Sensor | None) -> Content:
    """A public set: its reference as the first frame, then a frame for each of its samples."""
    recorded = recorded_set(name)
    if sensor is not None:
        raise InputError(f"The recorded set {name!r} has a sensor of its own: leave out --sensor.")
    recording = read_recording(name)
    samples = recording.samples
    rows = np.arange(1, len(samples) + 1)
    known = {name: samples[name] for name in ("x_m", "y_m", "depth_mm") if name in samples}
    if "state" in samples:
        known["state"] = samples["state"].astype(str)
    labels = label_table(rows, rows, known)
    frames = np.concatenate([recording.reference[None], recording.voltages])
    content = without_times(frames, recorded.sensor(), name, f"from {recorded.repository}")
    return replace(content, reference=np.array([0]), labels=labels)
