"""Labels of touches: columns of a sheet or of files of frames, as the table of a recording."""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.hardware.recording.importing.sources import ALL_COLUMNS, TEXTS, Arrays
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import InputError, counted
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.recordings.files.recording_file import label_table

_VALUES = {
    "x_mm": ("x_m", 1e-3),
    "x_m": ("x_m", 1.0),
    "y_mm": ("y_m", 1e-3),
    "y_m": ("y_m", 1.0),
    "depth_mm": ("depth_mm", 1.0),
    "depth_m": ("depth_mm", 1e3),
    "force_N": ("force_N", 1.0),
    "pressure_Pa": ("pressure_Pa", 1.0),
    "pressure_kPa": ("pressure_Pa", 1e3),
}
"""Columns of numbers: that of the recording, and its unit in theirs."""
_ROWS = ("frame", "first", "last", "reference_first", "reference_last")
_KNOWN = {name.lower(): name for name in (*TEXTS, *_ROWS, *_VALUES)}
_PREFIX = "label_"  # in exported MATLAB files
_NEARLY = re.compile(
    r"(x|y)([^a-z]|$|mm|cm|m$|pos|coord)|pos|place|coord|depth|force|pressure|file|frame|first|last"
    "|reference"
)
"""Begin of a name that is meant as a column of labels, if it is none."""


@dataclass(frozen=True)
class FramesOf:
    """The frames of a file: `count` of them from row `start` of the recording."""

    path: Path
    start: int
    count: int


def is_label(name: str) -> bool:
    """True if an array or a column of this name describes touches, and not only their frames."""
    known = _known(name)
    return known in (*_VALUES, "state") or (known is not None and name.startswith(_PREFIX))


def _known(name: str) -> str | None:
    """The column of labels that a name stands for, whatever its case; None for another."""
    # The parts of an HDF5 file and the sheets of a workbook stand before a stroke.
    plain = name.rsplit("/", 1)[-1].strip().lower().replace(" ", "_").removeprefix(_PREFIX)
    return _KNOWN.get(plain)


def parsed(arrays: Arrays, path: Path) -> pd.DataFrame:
    """The label columns among `arrays`: one row per contact, in the units of a recording.

    What has one value alone holds for all rows.

    Raises:
        InputError: columns of unlike lengths, two for one thing, text or an infinite number where
            numbers belong, or a state that is too long.
    """
    columns: dict[str, Any] = {}
    for name, array in arrays.items():
        known = _known(name)
        if known is None:
            continue
        target, factor = _VALUES.get(known, (known, 1.0))
        if target in columns:
            raise InputError(f"{path} has two columns for {target!r}: leave one out.")
        if array.size != max(array.shape, default=1):
            raise InputError(
                f"{name!r} of {path} should be one column of labels, and has the shape "
                f"{array.shape}."
            )
        cells = array.reshape(-1)
        if known in TEXTS:
            columns[target] = [_text(cell) for cell in cells.tolist()]
            for text in columns[target] if target == "state" else ():
                if len(text.encode()) > layout.STATE_BYTES:
                    raise InputError(
                        f"A state has at most {layout.STATE_BYTES} bytes, and {path} holds "
                        f"{text!r}: shorten it."
                    )
        elif cells.dtype.kind not in "iufb":
            raise InputError(f"Column {name!r} of {path} should hold numbers only.")
        elif np.isinf(cells.astype(float)).any():
            raise InputError(f"Column {name!r} of {path} holds a number that is not finite.")
        elif known in _ROWS:
            columns[target] = _whole(cells.astype(float), known, path)
        else:
            columns[target] = cells.astype(float) * factor
    lengths = {len(column) for column in columns.values()} - {1}
    if len(lengths) > 1:
        told = ", ".join(f"{name} ({len(column)})" for name, column in columns.items())
        raise InputError(f"The labels of {path} are of unlike lengths: {told}.")
    n = max(lengths, default=1)
    return pd.DataFrame({k: list(c) * n if len(c) == 1 else c for k, c in columns.items()})


def _text(cell: object) -> str:
    if isinstance(cell, float):
        return "" if np.isnan(cell) else f"{cell:.15g}"
    return str(cell).strip()


def _whole(cells: Array, name: str, path: Path) -> Array:
    """Rows of frames; only those of a reference may be missing (-1)."""
    if name.startswith("reference"):
        cells = np.where(np.isnan(cells), -1, cells)
    if not (cells == np.floor(cells)).all():
        raise InputError(
            f"Column {name!r} of {path} should hold numbers of frames: whole numbers, counted from "
            "0."
        )
    return cells


def array_columns(given: str) -> tuple[str, list[str]]:
    """The array and the names of its columns that `--labels array:NAME:x_mm,y_mm` tells.

    Raises:
        InputError: it tells no columns, or one that is none of numbers with a unit.
    """
    name, _, told = given.removeprefix("array:").rpartition(":")
    columns = [column.strip() for column in told.split(",")]
    wrong = [column for column in columns if column not in _VALUES]
    if not name or wrong:
        raise InputError(
            f"--labels {given}: an array in the files of frames is given as array:NAME:x_mm,y_mm, "
            f"with a name for each of its columns, out of {', '.join(_VALUES)}."
        )
    return name, columns


def array_labels(arrays: Arrays, given: str, path: Path) -> pd.DataFrame:
    """The labels in the array that `given` names, see `array_columns`; as `parsed` gives them.

    Raises:
        InputError: there is no such array, or it has another number of columns.
    """
    name, columns = array_columns(given)
    array = arrays.get(name, np.empty(0))
    if array.ndim != 2 or array.shape[1] != len(columns) or array.dtype.kind not in "iuf":
        held = f"has the shape {' x '.join(map(str, array.shape))}" if name in arrays else "is none"
        raise InputError(
            f"--labels {given}: {path} should hold an array {name!r} of {len(columns)} columns of "
            f"numbers, a row for each touch; there {held}."
        )
    return parsed(dict(zip(columns, array.T, strict=True)), path)


def moved(table: pd.DataFrame, origin_mm: tuple[float, float] | None) -> pd.DataFrame:
    """The labels with places from another origin, which lies at `origin_mm` on the sensor.

    Raises:
        InputError: there are no places to move, or the origin is not finite.
    """
    if origin_mm is None:
        return table
    if not np.isfinite(origin_mm).all():
        raise InputError(f"--origin takes two numbers in mm, got {origin_mm[0]} {origin_mm[1]}.")
    if not has_place(table).any():
        raise InputError("--origin moves places, and the labels have none.")
    places = zip(("x_m", "y_m"), origin_mm, strict=True)
    return table.assign(**{k: table[k] + mm / 1e3 for k, mm in places if k in table})


def read_sheet(arrays: Arrays, path: Path) -> tuple[pd.DataFrame, list[str]]:
    """The sheet of labels in the file at `path`, and its columns that are none of labels.

    Raises:
        InputError: a column that looks like one of labels without being one, no column of labels,
            or as `parsed` raises.
    """
    unused = []
    for name in arrays:
        plain = name.strip().lower()
        if _known(name) or name in ("", ALL_COLUMNS):
            continue
        if plain in ("x", "y", "depth", "force", "pressure"):
            units = [column for column in _VALUES if column.startswith(plain)]
            raise InputError(
                f"Column {name!r} of {path} has no unit: name it {' or '.join(units)}."
            )
        if any(map(_known, arrays)) and not _NEARLY.match(plain.removeprefix(_PREFIX)):
            unused.append(name)
            continue
        raise InputError(
            f"Column {name!r} of {path} is unknown: the first line of a sheet of labels names its "
            f"columns, out of {', '.join(_KNOWN.values())}."
        )
    table = parsed(arrays, path)
    if not len(table):
        raise InputError(f"{path} holds no labels.")
    return table, unused


def placed(
    table: pd.DataFrame, files: list[FramesOf], reference: Index, path: Path
) -> tuple[pd.DataFrame, str, Counter[str]]:
    """The labels with `first` and `last` as rows of the recording, and how these were found.

    The counter says how many rows are left out, by the reason why.

    Args:
        table: as `parsed` gives it.
        files: whose frames the recording holds, one file after the other.
        reference: rows of the recording that show the untouched sensor.
        path: of the table.

    Raises:
        InputError: a file or a frame that is not there, or nothing says what a row is for.
    """
    frames = np.arange(files[0].start, files[-1].start + files[-1].count)
    touched = np.setdiff1d(frames, reference)
    has_rows = "frame" in table or {"first", "last"} <= set(table)
    # One row may stand for all frames of a file, whose arrays have any names.
    if not has_rows and len(table) > 1 and (ends := {"first", "last"} & set(table)):
        (given,), (other,) = ends, {"first", "last"} - ends
        raise InputError(
            f"{path} has a column {given!r} and none {other!r}: give both, or one column frame."
        )
    # Where rows of frames are counted from, and how many there are.
    base, held = np.array([files[0].start]), np.array([len(frames)])
    left_out = Counter[str]()
    if "file" in table:
        how = "by the names of the files"
        of = [_file(name, k, files, path) for k, name in enumerate(table["file"])]
        base, held = _starts_and_counts(of)
        if not has_rows:
            of = [_touched(file, touched) for file in of]
    elif has_rows:
        how = "by rows of frames, counted from 0"
        of = [FramesOf(path, files[0].start, len(frames))] * len(table)
    elif len(table) == len(files):
        how = f"row by row, for the files {files[0].path.name} to {files[-1].path.name}"
        of = [_touched(file, touched) for file in files]
        base, held = _starts_and_counts(files)
    elif len(table) in (len(frames), len(touched)):
        how = "row by row, for the frames"
        rows = frames if len(table) == len(frames) else touched
        of_touches, placed_rows = ~np.isin(rows, reference), has_place(table)
        marks = _described(table) & of_touches
        left_out["without a place or another value"] = int((of_touches & ~marks).sum())
        left_out["with a place, for frames of the reference"] = int(
            (~of_touches & placed_rows).sum()
        )
        table, of = table[marks], [FramesOf(path, row, 1) for row in rows[marks].tolist()]
    else:
        raise InputError(
            f"{path} has {len(table)} rows of labels for {len(frames)} frames ({len(touched)} "
            f"without the reference) in {counted(len(files), 'file')}: add a column file, frame, "
            "or first and last (frames are counted from 0)."
        )
    made = table.drop(columns=["file", "frame"], errors="ignore")
    start = np.array([f.start for f in of])
    count = np.array([f.count for f in of])
    first, last = np.zeros(len(of)), count - 1.0
    if has_rows:
        first = table["frame" if "frame" in table else "first"].to_numpy()
        last = table["frame" if "frame" in table else "last"].to_numpy()
    if (reverse := last < first).any():
        k = int(np.argmax(reverse))
        raise InputError(
            f"Row {k + 1} of {path} is for the frames {first[k]:.0f} to {last[k]:.0f}: the last "
            "frame is before the first."
        )
    if (wrong := (first < 0) | (last >= count)).any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"Row {k + 1} of {path} is for the frames {first[k]:.0f} to {last[k]:.0f}, and there "
            f"are frames 0 to {count[k] - 1} (counted from 0)."
        )
    for name, row in (("first", first), ("last", last)):
        made[name] = (start + row).astype(np.int64)
    before, until = (
        made[name].to_numpy() if name in made else np.full(len(made), -1)
        for name in ("reference_first", "reference_last")
    )
    own = (before >= 0) | (until >= 0)
    if (wrong := own & ((before < 0) | (until < before) | (until >= held))).any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"Row {k + 1} of {path} has the reference frames {_or_none(before[k])} to "
            f"{_or_none(until[k])}: give reference_first and reference_last, of the frames 0 to "
            f"{np.broadcast_to(held, own.shape)[k] - 1} (counted from 0)."
        )
    for name, row in (("reference_first", before), ("reference_last", until)):
        if own.any():
            made[name] = np.where(own, base + row, -1).astype(np.int64)
    # A row without a word about a touch, and no reference for one, is for a frame without one.
    marks = _described(made) | own
    left_out["without a place or another value"] += int((~marks).sum())
    return made[marks].reset_index(drop=True), how, left_out


def _starts_and_counts(files: list[FramesOf]) -> tuple[Index, Index]:
    return np.array([file.start for file in files]), np.array([file.count for file in files])


def _or_none(row: float) -> str:
    return "none" if row < 0 else f"{row:.0f}"


def _touched(file: FramesOf, touched: Index) -> FramesOf:
    """The part of a file from its first to its last frame that is no reference frame."""
    rows = touched[(touched >= file.start) & (touched < file.start + file.count)]
    if not rows.size:
        return file
    return FramesOf(file.path, int(rows[0]), int(rows[-1] - rows[0]) + 1)


def without_touch(table: pd.DataFrame, files: list[FramesOf], reference: Index) -> list[str]:
    """Names of the files that the labels of `placed` say no touch of, but those of references."""
    ends = table[["first", "last"]].to_numpy() if len(table) else np.empty((0, 2))
    names = []
    for file in files:
        rows = np.arange(file.start, file.start + file.count)
        touched = ((ends[:, 0] <= rows[-1]) & (ends[:, 1] >= rows[0])).any()
        if not touched and not np.isin(rows, reference).all():
            names.append(file.path.name)
    return names


def has_place(table: pd.DataFrame) -> NDArray[np.bool_]:
    """True (n,) for the rows with both coordinates of a place."""
    return table.reindex(columns=["x_m", "y_m"]).notna().all(axis=1).to_numpy()


def _described(table: pd.DataFrame) -> NDArray[np.bool_]:
    """True (n,) for the rows with a place, a state or another value of a touch."""
    told = [table[name].notna() for name in table if name not in (*_ROWS, *TEXTS)]
    if "state" in table:
        told.append(table["state"] != "")
    return np.any(told, axis=0) if told else np.ones(len(table), dtype=bool)


def _file(name: str, row: int, files: list[FramesOf], path: Path) -> FramesOf:
    found = [
        f
        for f in files
        if name in (f.path.name, f.path.stem) or f.path.as_posix().endswith(f"/{name}")
    ]
    if len(found) != 1:
        what = "several of the files" if found else f"none of the {len(files)} files"
        raise InputError(f"Row {row + 1} of {path} is for the file {name!r}, which is {what}.")
    return found[0]


def as_labels(table: pd.DataFrame) -> pd.DataFrame:
    """The labels of `Content` of a table by `placed`: what it does not say is unknown."""
    known: dict[str, Any] = {}
    for name in map(str, table):
        # Of several files some may lack a column.
        kind = layout.LABEL[name].kind
        unknown: Any = {"f": np.nan, "i": -1, "S": ""}[kind]
        cells = table[name].fillna(unknown).to_numpy()
        known[name] = cells if kind == "S" else np.asarray(cells, dtype=layout.LABEL[name])
    first, last = known.pop("first", np.empty(0)), known.pop("last", np.empty(0))
    return label_table(first.astype(np.int64), last.astype(np.int64), known)
