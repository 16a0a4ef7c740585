"""A recording of files that other programs wrote: frames, reference and labels put together."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench.hardware.recording.importing import labels as sheets
from eitbench.hardware.recording.importing.arrays import Choice, FoundFrames, find_frames
from eitbench.hardware.recording.importing.labels import FramesOf
from eitbench.hardware.recording.importing.sources import (
    ALL_COLUMNS,
    Arrays,
    found_files,
    read_arrays,
)
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.files.csv_mat import without_times
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.sensors.sensor import Sensor

_REFERENCE = "reference"


@dataclass(frozen=True)
class ImportOptions:
    """What a user says about the files of an import; None: what the files say.

    Attributes:
        frames: which array holds frames, and how.
        labels: path of a sheet of labels.
        reference: a path, `first:N` frames, `array:NAME` of the same files, or `none`.
    """

    frames: Choice = field(default_factory=Choice)
    labels: Path | None = None
    reference: str | None = None


@dataclass(frozen=True, eq=False)
class _File:
    path: Path
    arrays: Arrays
    frames: FoundFrames


def import_files(
    sources: Sequence[str], sensor: Sensor, options: ImportOptions
) -> tuple[Content, list[str]]:
    """The recording of frames of `sensor` in files, folders and patterns, and what was found.

    Raises:
        InputError: something is not there or fits twice, with what to say about it.
        UnreadableError, DataCorruptError: a file cannot be read, or is not what it should be.
    """
    reference_paths = _reference_paths(options.reference)
    beside = [*reference_paths, *([options.labels] if options.labels else [])]
    paths, others = found_files(sources, beside)
    files = [_read(path, sensor, options.frames) for path in paths]
    values, parts, rows, of_reference = _stacked(files, sensor, options, reference_paths)
    sheet = None if options.labels is None else read_sheet(options.labels)
    table, of_labels = _label_table(files, sheet, parts, rows, options.labels)
    hows = Counter(file.frames.how for file in files)
    said = [f"From {_count(count, 'file')}: {how}." for how, count in hows.items()]
    if others:
        said.append(f"Not read: {_count(others, 'file')} of other kinds.")
    if options.frames.part == "magnitude" and not sensor.pattern.magnitudes:
        sensor = replace(sensor, pattern=replace(sensor.pattern, magnitudes=True))
        said.append("The sensor's pattern in the recording says that values have no sign.")
    said += [of_reference, of_labels]
    if unused := _unused(files, options):
        said.append(f"Not used: {', '.join(unused)}.")
    content, lost = as_content(values, table, rows, sensor)
    return content, [*said, *_not_held(lost)]


def as_content(
    values: Array, table: pd.DataFrame, reference: Index, sensor: Sensor
) -> tuple[Content, list[str]]:
    """The recording of frames (n, M), and the columns of labels that it cannot hold.

    Args:
        values: the frames.
        table: labels as `labels.placed` gives them.
        reference: rows of the frames that show the untouched sensor.
        sensor: that they were measured on.
    """
    labels, lost = sheets.as_labels(table)
    content = without_times(values, sensor, "imported")
    return replace(content, reference=reference, labels=labels), lost


def _reference_paths(reference: str | None) -> list[Path]:
    if reference is None or reference == "none" or reference.startswith(("first:", "array:")):
        return []
    return found_files([reference])[0]


def _read(path: Path, sensor: Sensor, choice: Choice) -> _File:
    arrays = read_arrays(path)
    # `reference` and `label_...` are what our exported files call them.
    others = {
        name: array
        for name, array in arrays.items()
        if choice.name == name or not (name == _REFERENCE or sheets.is_label(name))
    }
    return _File(path, arrays, find_frames(others, sensor, path, choice))


def _stacked(
    files: list[_File], sensor: Sensor, options: ImportOptions, reference_paths: list[Path]
) -> tuple[Array, list[FramesOf], Index, str]:
    """Frames (n, M), those of each file, the rows of the reference, and what it is.

    Reference frames that are no frames of the files come first.
    """
    untouched, own_rows, said = _reference_frames(files, sensor, options, reference_paths)
    start = sum(map(len, untouched))
    parts, rows = [], [np.arange(start)]
    at = start
    for file, own in zip(files, own_rows, strict=True):
        parts.append(FramesOf(file.path, at, len(file.frames.values)))
        rows.append(at + own)
        at += len(file.frames.values)
    if options.reference is not None and options.reference.startswith("first:"):
        rows = [reference_rows(options.reference, at)]
    reference = np.concatenate(rows).astype(np.int64)
    values = np.concatenate([*untouched, *(file.frames.values for file in files)])
    said = f"Reference: {_count(len(reference), 'frame')}{said}."
    return values, parts, reference, said


def _reference_frames(
    files: list[_File], sensor: Sensor, options: ImportOptions, reference_paths: list[Path]
) -> tuple[list[Array], list[Index], str]:
    """Reference frames beside the frames, rows of those among each file's, and where from."""
    none = [np.empty(0, dtype=np.int64) for _ in files]
    given = options.reference
    if given == "none" or (given or "").startswith("first:"):
        return [], none, "" if given == "none" else ", the first ones"
    if reference_paths:
        # The array that holds the frames may have another name there.
        choice = replace(options.frames, name=None)
        found = []
        for path in reference_paths:
            arrays = read_arrays(path)
            same = {n: a for n, a in arrays.items() if n == options.frames.name}
            found.append(find_frames(same or arrays, sensor, path, choice).values)
        return found, none, f" of {given}"
    if given is not None:
        name = given.removeprefix("array:")
        choice = replace(options.frames, name=name)
        return (
            [find_frames(file.arrays, sensor, file.path, choice).values for file in files],
            none,
            f" of array {name!r}",
        )
    if not any(_REFERENCE in file.arrays for file in files):
        return [], none, ", since neither the files nor --reference name any"
    untouched, rows = [], []
    for file, nothing in zip(files, none, strict=True):
        array = file.arrays.get(_REFERENCE)
        if array is None or not array.size or file.frames.name == _REFERENCE:
            rows.append(nothing)
        elif _are_rows(array, len(file.frames.values)):
            rows.append(array.reshape(-1).astype(np.int64))
        else:
            rows.append(nothing)
            one = {_REFERENCE: array}
            choice = replace(options.frames, name=None)
            untouched.append(find_frames(one, sensor, file.path, choice).values)
    return untouched, rows, f" of array {_REFERENCE!r}"


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


def relabelled(content: Content, path: Path, sheet: Path) -> tuple[pd.DataFrame, list[str]]:
    """The labels that a sheet gives to the recording at `path`, and what they are."""
    part = FramesOf(path, 0, len(content))
    table, how = sheets.placed(read_sheet(sheet), [part], content.reference, sheet)
    labels, lost = sheets.as_labels(table)
    return labels, [f"{touches(table)} by {sheet} ({how}).", *_not_held(lost)]


def _not_held(lost: list[str]) -> list[str]:
    if not lost:
        return []
    return [f"A recording cannot hold these columns of labels: {', '.join(lost)}."]


def read_sheet(path: Path) -> pd.DataFrame:
    """The sheet of labels at `path`, as `labels.read_sheet` gives it."""
    paths, _ = found_files([str(path)])
    if len(paths) > 1:
        raise InputError(f"{path} holds {len(paths)} files: labels are one sheet.")
    return sheets.read_sheet(read_arrays(paths[0]), paths[0])


def _label_table(
    files: list[_File],
    sheet: pd.DataFrame | None,
    parts: list[FramesOf],
    reference: Index,
    path: Path | None,
) -> tuple[pd.DataFrame, str]:
    """Labels by rows of the recording, of a sheet or else of the files, and what they are."""
    if sheet is not None and path is not None:
        table, how = sheets.placed(sheet, parts, reference, path)
        return table, f"{touches(table)} by {path} ({how})."
    tables = []
    for file, part in zip(files, parts, strict=True):
        beside = {n: a for n, a in file.arrays.items() if n != file.frames.name}
        if any(map(sheets.is_label, beside)):
            inside = sheets.parsed(beside, file.path)
            tables.append(sheets.placed(inside, [part], reference, file.path)[0])
    if not tables:
        return pd.DataFrame(), (
            "Touches: none, since the files hold no labels and --labels names no sheet of them."
        )
    table = pd.concat(tables, ignore_index=True)
    return table, f"{touches(table)} by the files."


def touches(table: pd.DataFrame) -> str:
    """How many touches labels are for, and how many of these have a place: to be continued."""
    count = len(table[["first", "last"]].drop_duplicates())
    places = int(table.reindex(columns=["x_m", "y_m"]).notna().all(axis=1).sum())
    return f"Touches: {count}, {places if places < len(table) else 'all'} with a place,"


def _unused(files: list[_File], options: ImportOptions) -> list[str]:
    """Arrays and columns of the files that are neither frames nor labels nor reference."""
    found: dict[str, None] = {}
    for file in files:
        for name, array in file.arrays.items():
            used = name in (file.frames.name, _REFERENCE, ALL_COLUMNS)
            used |= f"array:{name}" == options.reference
            used |= file.frames.name == ALL_COLUMNS and array.dtype.kind != "U"
            used |= sheets.is_label(name) and options.labels is None
            if not used:
                shape = " x ".join(map(str, array.shape))
                found[f"{name or 'a column without a name'} ({shape})"] = None
    listed = list(found)
    return [*listed[:8], *([f"{len(listed) - 8} more"] if len(listed) > 8 else [])]


def _count(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what}s"
