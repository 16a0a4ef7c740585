"""Recordings as files for other programs: CSV and MATLAB, without loss.

Our CSV files hold lines `# name: JSON`, a line of column names and a line for each frame; the last
line, `# frames: n`, shows that nothing was cut off. Our MATLAB files hold arrays by the names of
the layout, and a header as JSON.
"""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.recordings.files.recording_file import (
    Content,
    header_of,
    table_of,
    table_rows,
)
from eitbench.scenarios.recordings.matlab import Variable, variables
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.sensor_file import sensor_from_json

COLUMNS = ("number", "time_s", "received_s")
"""Columns of every frame beside its values."""
_NO_TIMES = "imported without times: 1 s between frames is assumed"


def head_of(content: Content) -> dict[str, Any]:
    """All of a recording but its frames, as values that JSON has."""
    return {
        **header_of(content),
        "reference": content.reference.tolist(),
        "labels": content.labels.to_dict("list"),
        "events": content.events.to_dict("list"),
    }


def content_of(
    head: dict[str, Any], columns: dict[str, NDArray[Any]], values: NDArray[Any], path: Path
) -> Content:
    """Return the recording of a header by `head_of`, columns and values (n, M) of its frames.

    Raises:
        DataCorruptError: something is missing, or of another kind.
    """
    try:
        content = Content(
            sensor=sensor_from_json(head["sensor"]),
            board=str(head["board"]),
            firmware=str(head["firmware"]),
            emulated=bool(head["emulated"]),
            started=str(head["started"]),
            number=_whole(columns["number"]),
            time_s=columns["time_s"].astype(np.float64),
            received_s=columns["received_s"].astype(np.float64),
            values=values.astype(np.float64),
            reference=np.array(head["reference"], dtype=np.int64).reshape(-1),
            labels=table_of(table_rows(pd.DataFrame(head["labels"]), layout.LABEL)),
            events=table_of(table_rows(pd.DataFrame(head["events"]), layout.EVENT)),
            differences=bool(head["differences"]),
        )
    except InputError as error:
        raise DataCorruptError(f"{path} cannot be imported: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataCorruptError(
            f"{path} cannot be imported: its header or its columns are not complete ({error})."
        ) from error
    if content.values.ndim != 2 or content.values.shape[1] != content.sensor.n_measurements:
        raise DataCorruptError(
            f"{path} cannot be imported: its values have the shape {content.values.shape}, and a "
            f"frame of its sensor has {content.sensor.n_measurements}."
        )
    return content


def _whole(numbers: NDArray[Any]) -> NDArray[np.int64]:
    """The `numbers` of frames as integers."""
    if (numbers % 1 != 0).any():  # also where one is no number
        raise ValueError("a number of a frame is no whole number")
    return numbers.astype(np.int64)


def without_times(values: NDArray[np.float64], sensor: Sensor, board: str, *events: str) -> Content:
    """A recording of frames (n, M), one a second, without marks, and with these events."""
    count = np.arange(len(values))
    return Content(
        sensor=sensor,
        board=board,
        firmware="",
        emulated=False,
        started="unknown",
        number=count,
        time_s=count.astype(np.float64),
        received_s=count.astype(np.float64),
        values=values,
        reference=np.empty(0, dtype=np.int64),
        labels=table_of(np.empty(0, dtype=layout.LABEL)),
        events=pd.DataFrame({"time_s": 0.0, "text": [_NO_TIMES, *events]}),
    )


OURS, _COUNT = "# eitbench recording ", "# frames: "
_FIRST = f"{OURS}{layout.VERSION}"

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


def read_csv(path: Path) -> Content:
    """The recording in the CSV file at `path` that `write_csv` wrote.

    Raises:
        UnreadableError: the file cannot be read.
        DataCorruptError: something in it is not what it should be.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise UnreadableError(f"Cannot read {path}: {reason}.") from error
    lines = text.splitlines()
    body = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and line[0] != "#"]
    if not lines or lines[0] != _FIRST:
        raise DataCorruptError(
            f"{path} is a recording of another layout than {layout.VERSION}, which this eitbench "
            "reads: export it again."
        )
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


def _table(lines: Lines, path: Path, width: int) -> NDArray[np.float64]:
    """Read the numbers (n, width) of `lines`."""
    rows: list[list[float]] = []
    for number, line in lines:
        try:
            rows.append([float(cell) for cell in line.split(",")])
        except ValueError as error:
            raise DataCorruptError(
                f"{path} cannot be imported: line {number} holds something else than numbers."
            ) from error
        if len(rows[-1]) != width:
            raise DataCorruptError(
                f"{path} cannot be imported: line {number} has {len(rows[-1])} values, and its "
                f"line of column names has {width}."
            )
    return np.array(rows).reshape(len(rows), width)


_LONGEST_MAT = 2**31
"""Bytes that no variable of a MATLAB 5 file has."""


def write_mat(content: Content, path: Path) -> None:
    """Write `content` to the new file `path`; `read_mat_recording` reads it without loss."""
    import scipy.io

    arrays: dict[str, Any] = {name: getattr(content, name) for name in COLUMNS}
    arrays["values"] = content.values
    arrays["header"] = json.dumps(head_of(content))
    # What follows stands in the header too; it is for people who work in MATLAB.
    arrays["pattern"] = content.sensor.pattern.table
    arrays["reference"] = content.reference
    for name in layout.LABEL.names or ():
        text = layout.LABEL[name].kind == "S"
        column = content.labels[name].to_numpy(dtype=np.str_ if text else None)
        arrays[f"label_{name}"] = column
    if content.values.nbytes >= _LONGEST_MAT:
        raise InputError(
            f"{path} cannot hold {content.values.nbytes / 1e9:.1f} GB of frames: files of MATLAB "
            "hold less than 2 GB. Export it as .csv, or read the recording itself, which is HDF5."
        )
    path.touch(exist_ok=False)
    scipy.io.savemat(str(path), arrays, appendmat=False, do_compression=True, oned_as="column")


def read_mat_recording(path: Path) -> Content:
    """The recording in the MATLAB file at `path` that `write_mat` wrote.

    Raises:
        UnreadableError: the file cannot be read.
        DataCorruptError: something in it is not what it should be.
    """
    found = variables(path, (*COLUMNS, "values", "header"))
    values = _numbers(found, "values", path)
    if values.ndim != 2:
        raise DataCorruptError(f"Array 'values' of {path} has {values.ndim} dimensions, not 2.")
    try:
        head = json.loads(str(found.get("header")))
    except (ValueError, RecursionError) as error:
        raise DataCorruptError(f"{path} cannot be imported: its header is damaged.") from error
    columns = {name: _numbers(found, name, path).reshape(-1) for name in COLUMNS}
    if {len(column) for column in columns.values()} != {len(values)}:
        raise DataCorruptError(f"{path} cannot be imported: its arrays are of unlike lengths.")
    return content_of(head if isinstance(head, dict) else {}, columns, values, path)


def _numbers(found: dict[str, Variable], name: str, path: Path) -> NDArray[Any]:
    array = found.get(name)
    if array is None or isinstance(array, str):
        raise DataCorruptError(f"{path} holds no array {name!r}, so it cannot be imported.")
    return array
