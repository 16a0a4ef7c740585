"""Recordings as MATLAB files: arrays by the names of the layout, and a header as JSON."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.recordings.files.plain import COLUMNS, content_of, frames_alone, head_of
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.recordings.matlab import Variable, variables
from eitbench.scenarios.sensors.sensor import Sensor


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
        if name != "state":
            arrays[f"label_{name}"] = content.labels[name].to_numpy()
    path.touch(exist_ok=False)
    scipy.io.savemat(str(path), arrays, appendmat=False, do_compression=True, oned_as="column")


def read_mat_recording(path: Path, sensor: Sensor | None) -> Content:
    """The recording in the MATLAB file at `path`: our own, or an array `values` (n, M).

    Args:
        path: of the file.
        sensor: that `values` were measured on; our own files know it.

    Raises:
        InputError: no sensor where one is needed, or one where none is.
        UnreadableError: the file cannot be read.
        DataCorruptError: something in it is not what it should be.
    """
    found = _variables(path, (*COLUMNS, "values", "header"))
    values = _numbers(found, "values", path)
    if values.ndim != 2:
        raise DataCorruptError(f"Array 'values' of {path} has {values.ndim} dimensions, not 2.")
    if "header" not in found:
        return frames_alone(values.astype(np.float64), sensor, path)
    if sensor is not None:
        raise InputError(f"{path} says on which sensor it was measured: leave out --sensor.")
    try:
        head = json.loads(str(found["header"]))
    except (ValueError, RecursionError) as error:
        raise DataCorruptError(f"{path} cannot be imported: its header is damaged.") from error
    columns = {name: _numbers(found, name, path).reshape(-1) for name in COLUMNS}
    if {len(column) for column in columns.values()} != {len(values)}:
        raise DataCorruptError(f"{path} cannot be imported: its arrays are of unlike lengths.")
    return content_of(head if isinstance(head, dict) else {}, columns, values, path)


def _variables(path: Path, names: tuple[str, ...]) -> dict[str, Variable]:
    try:
        return variables(path, names)
    except OSError as error:
        raise UnreadableError(f"Cannot read {path}: {error.strerror}.") from error
    except Exception as error:
        raise DataCorruptError(
            f"{path} is not a readable MATLAB file: save it with -v7, or again."
        ) from error


def _numbers(found: dict[str, Variable], name: str, path: Path) -> NDArray[Any]:
    array = found.get(name)
    if array is None or isinstance(array, str):
        raise DataCorruptError(f"{path} holds no array {name!r}, so it cannot be imported.")
    return array
