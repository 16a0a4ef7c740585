"""Recordings as CSV files: lines `# name: JSON`, a line of column names, a line for each frame."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.plain import COLUMNS, content_of, frames_alone, head_of
from eitbench.scenarios.recordings.recording_file import Content
from eitbench.scenarios.sensors import Sensor

_FIRST = "# eitbench recording 1"


def write_csv(content: Content, path: Path) -> None:
    """Write `content` to the new file `path`; `read_csv` reads it without loss."""
    values = (f"v{k}" for k in range(content.sensor.n_measurements))
    with path.open("x", encoding="utf-8", newline="") as file:
        file.write(f"{_FIRST}\n")
        for name, value in head_of(content).items():
            file.write(f"# {name}: {json.dumps(value)}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*COLUMNS, *values])
        columns = (getattr(content, name).tolist() for name in COLUMNS)
        # Python writes a float with as many digits as it takes to read the same one again.
        for *known, frame in zip(*columns, content.values.tolist(), strict=True):
            writer.writerow([*known, *frame])


def read_csv(path: Path, sensor: Sensor | None) -> Content:
    """The recording in the CSV file at `path`: our own, or lines of M values, named or not.

    Args:
        path: of the file.
        sensor: that lines of values were measured on; our own files know it.

    Raises:
        InputError: no sensor where one is needed, or one where none is.
        UnreadableError: the file cannot be read.
        DataCorruptError: something in it is not what it should be.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise UnreadableError(f"Cannot read {path}: {reason}.") from error
    lines = text.splitlines()
    body = [line for line in lines if not line.startswith("#")]
    if not lines or lines[0] != _FIRST:
        return frames_alone(_table(body[_are_names(body[:1]) :], path), sensor, path)
    if sensor is not None:
        raise InputError(f"{path} says on which sensor it was measured: leave out --sensor.")
    head = _head([line for line in lines[1:] if line.startswith("#")], path)
    if not body or body[0].split(",")[: len(COLUMNS)] != list(COLUMNS):
        raise DataCorruptError(f"{path} cannot be imported: its columns are not {COLUMNS} and v0.")
    table = _table(body[1:], path, len(body[0].split(",")))
    columns = {name: table[:, k] for k, name in enumerate(COLUMNS)}
    return content_of(head, columns, table[:, len(COLUMNS) :], path)


def _are_names(lines: list[str]) -> bool:
    """Whether the first line holds names of columns, not numbers."""
    try:
        [float(cell) for line in lines for cell in line.split(",")]
    except ValueError:
        return True
    return False


def _head(lines: list[str], path: Path) -> dict[str, Any]:
    head = {}
    for line in lines:
        name, _, value = line.removeprefix("# ").partition(": ")
        try:
            head[name] = json.loads(value)
        except ValueError as error:
            raise DataCorruptError(f"{path} cannot be imported: its {name} is damaged.") from error
    return head


def _table(lines: list[str], path: Path, width: int = 0) -> np.ndarray[Any, np.dtype[np.float64]]:
    if not lines:
        return np.empty((0, width))
    try:
        return np.loadtxt(io.StringIO("\n".join(lines)), delimiter=",", ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise DataCorruptError(
            f"{path} cannot be imported: its lines are not all of as many numbers ({error})."
        ) from error
