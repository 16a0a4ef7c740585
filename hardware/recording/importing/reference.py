"""The frames of the untouched sensor among the files of an import."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from eitbench.hardware.recording.importing.arrays import Choice, FrameFile, find_frames
from eitbench.hardware.recording.importing.labels import FramesOf
from eitbench.hardware.recording.importing.sources import (
    found_files,
    is_own,
    own_content,
    read_arrays,
)
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import InputError, counted
from eitbench.scenarios.recordings.files.own import untouched_rows
from eitbench.scenarios.sensors.sensor import Sensor

REFERENCE = "reference"
"""Name of an array that holds reference frames, or their rows among the frames."""


def reference_paths(given: str | None) -> list[Path]:
    """The files that `--reference` names; none where it says something else.

    Raises:
        InputError: it is empty, or names a file that is not there.
    """
    if given is None or given == "none" or given.startswith(("first:", "array:")):
        return []
    if not given.strip():
        raise InputError("--reference is empty: name a file, first:N, array:NAME or none.")
    if ":" in given and not Path(given).exists():
        raise InputError(
            f"--reference is {given!r}, which is no file: it names a file, or is first:N, "
            "array:NAME or none."
        )
    return found_files([given])[0]


def stacked(
    files: list[FrameFile], sensor: Sensor, choice: Choice, given: str | None
) -> tuple[Array, list[FramesOf], Index, str]:
    """Frames (n, M), those of each file, the rows of the reference, and a sentence about it.

    Reference frames that are no frames of the files come first.
    """
    beside, rows_in, where = _found(files, sensor, choice, given)
    start = sum(map(len, beside))
    parts, rows, at = [], [np.arange(start)], start
    for file, inside in zip(files, rows_in, strict=True):
        parts.append(FramesOf(file.path, at, len(file.frames.values)))
        rows.append(at + inside)
        at += len(file.frames.values)
    if given is not None and given.startswith("first:"):
        rows = [reference_rows(given, at)]
    reference = np.concatenate(rows).astype(np.int64)
    values = np.concatenate([*beside, *(file.frames.values for file in files)])
    return values, parts, reference, f"Reference: {counted(len(reference), 'frame')}{where}."


def _found(
    files: list[FrameFile], sensor: Sensor, choice: Choice, given: str | None
) -> tuple[list[Array], list[Index], str]:
    """Reference frames beside the frames, rows of those among each file's, and where from."""
    nowhere = [np.empty(0, dtype=np.int64) for _ in files]
    unnamed = replace(choice, name=None)
    if given == "none":
        return [], nowhere, ""
    if given is not None and given.startswith("first:"):
        return [], nowhere, ", the first ones"
    if given is not None and given.startswith("array:"):
        named = replace(choice, name=given.removeprefix("array:"))
        beside = [find_frames(f.arrays, sensor, f.path, named).values for f in files]
        return beside, nowhere, f" of array {named.name!r}"
    if given is not None:
        beside = []
        for path in reference_paths(given):
            if is_own(path):
                beside.append(_of_recording(path, sensor, choice))
                continue
            arrays = read_arrays(path)
            # The array that holds the frames may have another name there.
            known = choice if choice.name in arrays else unnamed
            beside.append(find_frames(arrays, sensor, path, known).values)
        return beside, nowhere, f" of {given}"
    if not any(REFERENCE in file.arrays for file in files):
        return [], nowhere, ", since neither the files nor --reference name any"
    beside, rows = [], nowhere
    for k, file in enumerate(files):
        array = file.arrays.get(REFERENCE, np.empty(0))
        if _are_rows(array, len(file.frames.values)):
            rows[k] = array.reshape(-1).astype(np.int64)
        elif array.size and file.frames.name != REFERENCE:
            only = {REFERENCE: array}
            beside.append(find_frames(only, sensor, file.path, unnamed).values)
    return beside, rows, f" of array {REFERENCE!r}"


def _of_recording(path: Path, sensor: Sensor, choice: Choice) -> Array:
    """The reference frames (n, M) of a recording.

    Raises:
        InputError: it marks none, or they are of another number of values or drive pattern.
    """
    content = own_content(path)
    untouched = untouched_rows(content)
    if not len(untouched):
        raise InputError(f"--reference {path}: it marks no frames of the untouched sensor.")
    if content.sensor.n_measurements != sensor.n_measurements:
        raise InputError(
            f"--reference {path}: its frames have {content.sensor.n_measurements} values, and "
            f"those of sensor {sensor.name!r} have {sensor.n_measurements}."
        )
    if not np.array_equal(content.sensor.pattern.table, sensor.pattern.table):
        raise InputError(
            f"--reference {path}: its values are of another drive pattern than those of sensor "
            f"{sensor.name!r}."
        )
    values = content.values[untouched]
    if choice.part == "magnitude" or sensor.pattern.magnitudes:
        return np.abs(values)
    if content.sensor.pattern.magnitudes:
        raise InputError(f"--reference {path}: it holds magnitudes, and the frames have signs.")
    return values


def _are_rows(array: Array, count: int) -> bool:
    """True if an array `reference` holds rows of the `count` frames beside it."""
    if array.dtype.kind not in "iuf" or array.size != max(array.shape):
        return False
    flat = array.reshape(-1)
    return bool(((flat == np.floor(flat)) & (flat >= 0) & (flat < count)).all())


def reference_rows(reference: str, count: int) -> Index:
    """Rows of the reference among `count` frames, by `first:N` or `none`.

    Raises:
        InputError: it is neither.
    """
    number = reference.removeprefix("first:")
    if reference == "none":
        return np.empty(0, dtype=np.int64)
    if not (number.isdecimal() and number != reference and 1 <= int(number) <= count):
        raise InputError(
            f"--reference {reference}: of these {count} frames it is first:N, with N from 1 to "
            f"{count}, or none."
        )
    return np.arange(int(number))
