"""Recordings as CSV files: lines `# name: JSON`, a line of column names, a line for each frame.

The last line, `# frames: n`, shows that nothing was cut off.
"""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.files.plain import COLUMNS, content_of, frames_alone, head_of
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.sensors.sensor import Sensor

_FIRST, _COUNT = "# eitbench recording 1", "# frames: "

Lines = list[tuple[int, str]]
"""Lines of a file by their numbers, from 1."""


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
        file.write(f"{_COUNT}{len(content)}\n")


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
    body = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and line[0] != "#"]
    if not lines or lines[0] != _FIRST:
        rows = body[_are_names(body[:1]) :]
        table = _table(rows, path)
        if (wrong := ~np.isfinite(table).all(axis=1)).any():
            raise DataCorruptError(
                f"{path} cannot be imported: line {rows[int(np.argmax(wrong))][0]} holds a value "
                "that is not a finite number."
            )
        return frames_alone(table, sensor, path)
    if sensor is not None:
        raise InputError(f"{path} says on which sensor it was measured: leave out --sensor.")
    head = _head(
        [line for line in lines[1:] if line.startswith("#") and not line.startswith(_COUNT)], path
    )
    names = body[0][1].split(",") if body else []
    if names[: len(COLUMNS)] != list(COLUMNS):
        raise DataCorruptError(f"{path} cannot be imported: its columns are not {COLUMNS} and v0.")
    table = _table(body[1:], path, len(names))
    if lines[-1] != f"{_COUNT}{len(table)}":
        raise DataCorruptError(
            f"{path} cannot be imported: it was cut short or edited, since its last line, "
            f"{len(lines)}, is not '{_COUNT}{len(table)}'; export it again."
        )
    columns = {name: table[:, k] for k, name in enumerate(COLUMNS)}
    return content_of(head, columns, table[:, len(COLUMNS) :], path)


def _are_names(lines: Lines) -> bool:
    """True if the first line holds names of columns, not numbers."""
    try:
        [float(cell) for _, line in lines for cell in line.split(",")]
    except ValueError:
        return True
    return False


def _head(lines: list[str], path: Path) -> dict[str, Any]:
    head = {}
    for line in lines:
        name, _, value = line.removeprefix("# ").partition(": ")
        try:
            head[name] = json.loads(value)
        except (ValueError, RecursionError) as error:
            raise DataCorruptError(
                f"{path} cannot be imported: its {name[:20]} is damaged."
            ) from error
    return head


def _table(lines: Lines, path: Path, width: int | None = None) -> NDArray[np.float64]:
    """Read the numbers (n, width) of `lines`; by default each has as many as the first."""
    if width is None:
        width = len(lines[0][1].split(",")) if lines else 0
    rows = np.empty((len(lines), width))
    for row, (number, line) in zip(rows, lines, strict=True):
        cells = line.split(",")
        if len(cells) != width:
            raise DataCorruptError(
                f"{path} cannot be imported: line {number} has {len(cells)} values, and those "
                f"before it have {width}."
            )
        try:
            row[:] = [float(cell) for cell in cells]
        except ValueError as error:
            raise DataCorruptError(
                f"{path} cannot be imported: line {number} holds something else than numbers."
            ) from error
    return rows
