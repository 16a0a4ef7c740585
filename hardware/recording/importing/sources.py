"""Files that other programs wrote, as named arrays: text, MATLAB, NumPy, HDF5 and Excel."""

import csv
import re
import zipfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError, UnreadableError
from eitbench.scenarios.extras import missing
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.recordings.files.csv_mat import OURS, read_csv, read_mat_recording
from eitbench.scenarios.recordings.files.own import undamaged
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.recordings.matlab import all_variables, text_lines, variables
from eitbench.scenarios.storage.limits import most_bytes, own_dataset
from eitbench.scenarios.storage.try_reading import try_reading

Arrays = dict[str, NDArray[Any]]
"""Arrays of numbers, and columns of text (n,), by name."""
Rows = list[tuple[int, list[str]]]
"""Cells of a table by the number of their line, from 1."""

TABLE = "values"
"""Name of the array of a table without names of columns, and of a file with one array."""
ALL_COLUMNS = "all columns"
"""Name of the array of all columns of numbers, where a table has more than one series."""
TEXTS = ("file", "state")
"""Names of columns that are text, whatever their cells look like."""
UNREAD: NDArray[Any] = np.empty(0, dtype=object)
"""In the place of what a file holds beside arrays of numbers and text, such as structs."""
_EXPORTED = {".csv": read_csv, ".mat": read_mat_recording}
_HDF5 = b"\x89HDF\r\n\x1a\n"
_SERIES = re.compile(r"(.*?)[\s_.(\[-]*(\d+)[)\]]?")


def found_files(sources: Sequence[str], besides: Iterable[Path] = ()) -> tuple[list[Path], int]:
    """Files, folders and patterns (`press*.csv`) as files, press2 before press10.

    Args:
        sources: what is looked for; of a folder the files that lie directly in it.
        besides: files that are read as something else, and left out.

    Returns:
        The files, and how many in the folders are of other kinds.

    Raises:
        UnreadableError: there is no such file.
        InputError: a folder or pattern leads to no file, none is left beside `besides`, or a file
            is of a kind that is not read.
    """
    found: list[Path] = []
    others = 0
    skipped = {path.resolve() for path in besides}
    for source in sources:
        path = Path(source)
        if path.is_dir():
            inside = [p for p in path.iterdir() if p.is_file() and not p.name.startswith(".")]
            known = [p for p in inside if p.suffix.lower() in READERS]
            others += len(inside) - len(known)
        elif path.exists():
            known = [path]
        elif not set(source) & set("*?["):
            raise UnreadableError(f"Cannot read {source}: No such file or directory.")
        else:
            known = list(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
        files = [p for p in sorted(known, key=natural) if p.resolve() not in skipped]
        if not known:
            raise InputError(f"{source} holds no file of {', '.join(READERS)}.")
        found += files
    if not found:
        raise InputError(
            f"All files of {', '.join(map(str, sources))} are given as reference or labels, so "
            "that no file of frames is left. For a reference among the frames say --reference "
            "first:N."
        )
    return list(dict.fromkeys(found)), others


def natural(path: Path) -> list[tuple[int, str]]:
    """A key that sorts numbers in names by their size."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def read_arrays(path: Path) -> Arrays:
    """All arrays of the file at `path`, tried first in a process of its own.

    Of a table with names of columns: series such as v0, v1, ... by what stands before the number,
    other columns each by its name, and `ALL_COLUMNS` together.

    Raises:
        InputError: a file of a kind that is not read, or a package is missing that reads it.
        UnreadableError: the file cannot be read.
        DataCorruptError: something in it is not what it should be.
    """
    if path.suffix.lower() == ".xlsx" and (why := missing("openpyxl")):
        raise InputError(f"Excel files cannot be read: {why}")
    try_reading(path, arrays_of, path)
    return arrays_of(path)


def arrays_of(path: Path) -> Arrays:
    """As `read_arrays`, with the same errors, without trying."""
    if not path.exists():
        raise UnreadableError(f"Cannot read {path}: No such file or directory.")
    if path.suffix.lower() not in READERS:
        raise InputError(f"{path} is not read: frames are in {', '.join(READERS)} files.")
    try:
        return READERS[path.suffix.lower()](path)
    except EitbenchError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or (
            "it is not UTF-8 text, so save it as such"
            if isinstance(error, UnicodeDecodeError)
            else "it is damaged"
        )
        raise UnreadableError(f"Cannot read {path}: {reason}.") from error
    except MemoryError:
        raise
    except Exception as error:  # a damaged file fails in whatever way the damage leads to
        reason = str(error).rstrip(".")
        raise DataCorruptError(f"{path} cannot be imported: {reason}.") from error


def is_own(path: Path) -> bool:
    """True if the file at `path` is a recording, or was exported from one with all it holds."""
    import h5py

    if not path.is_file():
        return False
    if path.suffix == ".csv":
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            return file.read(len(OURS)) == OURS
    if path.suffix == ".mat" and not _is_hdf5(path):
        try_reading(path, variables, path, ("header",))
        return "header" in variables(path, ("header",))
    if path.suffix == ".h5":
        with suppress(OSError), h5py.File(path, "r") as opened:
            return bool(opened.attrs.get("format") == layout.FORMAT.encode())
    return False


def own_content(path: Path) -> Content:
    """What the file at `path` holds, of which `is_own` is true; of one cut off, what is intact.

    Raises:
        UnreadableError, DataCorruptError: it cannot be read, or is damaged.
    """
    if (reader := _EXPORTED.get(path.suffix)) is None:
        return undamaged(path)[0]
    try_reading(path, reader, path)
    return reader(path)


def _text(path: Path) -> Arrays:
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    body = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and line[0] not in "#%"]
    if not body:
        raise ValueError("it holds no lines of values")
    if lines[0].startswith(OURS):
        raise ValueError("it is a whole recording, which is imported alone")
    delimiter = next((mark for mark in "\t;," if mark in body[0][1]), None)
    rows: Rows = []
    for number, line in body:
        if delimiter is None:
            rows.append((number, line.split()))
        else:
            (cells,) = csv.reader([line], delimiter=delimiter, skipinitialspace=True)
            rows.append((number, [cell.strip() for cell in cells]))
    if delimiter == "," and all(re.fullmatch(r"[-+]?\d+,\d+", line.strip()) for _, line in body):
        raise ValueError(
            "each line is two whole numbers or one with a decimal comma: write decimal points, or "
            "semicolons between whole numbers"
        )
    points = ("." in cell and _is_number(cell) for _, cells in rows for cell in cells)
    if delimiter != "," and not any(points):
        rows = [(k, [_with_point(cell) for cell in cells]) for k, cells in rows]
    return _table(rows)


def _with_point(cell: str) -> str:
    """A number with a decimal point instead of a comma; any other cell as it is."""
    return cell.replace(",", ".") if re.fullmatch(r"[-+\d,eEij]+", cell) else cell


def _table(rows: Rows) -> Arrays:
    """Arrays of a table, as `read_arrays` names them."""
    width = len(rows[0][1])
    for number, cells in rows:
        if len(cells) != width:
            raise ValueError(
                f"line {number} has {len(cells)} values, and those before it have {width}"
            )
    while width > 1 and not any(cells[width - 1] for _, cells in rows):
        width -= 1  # every line ends with a delimiter
    names = [name.strip('" ') for name in rows[0][1][:width]]
    named = not all(_is_number(name) for name in names) or _are_numbered(names)
    if named and any(_is_number(name) and not name.isdecimal() for name in names):
        wrong = next(name for name in names if not _is_number(name))
        raise ValueError(
            f"line {rows[0][0]} holds numbers and {wrong!r}: give the value that is missing, or a "
            "line of names before it"
        )
    columns = [
        np.array([cells[i] for _, cells in rows[1:]], dtype=np.str_)
        if named and names[i].lower() in TEXTS
        else _column([(k, cells[i]) for k, cells in rows[named:]])
        for i in range(width)
    ]
    if not named:
        for column in columns:
            _refuse_text(column, rows)
        return {TABLE: np.column_stack(columns)}
    if twice := {name for name in names if name and names.count(name) > 1}:
        raise ValueError(f"it has several columns {min(twice)!r}")
    return _grouped(dict(zip(names, columns, strict=True)), rows[1:])


def _grouped(columns: Arrays, rows: Rows) -> Arrays:
    """Numbered columns as arrays (n, k), sorted by their numbers; others by their names."""
    series: dict[str, dict[int, str]] = {}
    for name in columns:
        if match := _SERIES.fullmatch(name):
            members = series.setdefault(match[1], {})
            if (other := members.setdefault(int(match[2]), name)) != name:
                raise ValueError(f"it has the columns {other!r} and {name!r}, which are one number")
    found: Arrays = {}
    for prefix, members in series.items():
        if len(members) > 1:
            parts = [columns[members[k]] for k in sorted(members)]
            if any(part.dtype.kind != "U" for part in parts):
                for part in parts:
                    _refuse_text(part, rows)
                found[prefix or TABLE] = np.column_stack(parts)
    in_series = {name for m in series.values() if len(m) > 1 for name in m.values()}
    for name in (name for name in columns if name not in in_series):
        found[f"{name} alone" if name in found else name] = columns[name]
    numbers = [column for column in columns.values() if column.dtype.kind != "U"]
    if 1 < len(numbers) != max((a.shape[1] for a in found.values() if a.ndim == 2), default=0):
        found[ALL_COLUMNS] = np.column_stack(numbers)
    return found


def _column(cells: Rows | list[tuple[int, str]]) -> NDArray[Any]:
    """Numbers (n,), NaN where a cell is empty; as text if there is anything else."""
    texts = [str(cell) for _, cell in cells]
    try:
        values = [_number(text) if text else np.nan for text in texts]
    except ValueError:
        return np.array(texts, dtype=np.str_)
    return np.array(values)


def _number(text: str) -> complex:
    if "_" in text:  # which Python allows in numbers
        raise ValueError(text)
    if text[-1] in "ij":
        return complex(text[:-1].replace(" ", "") + "j")
    return float(text)


def _is_number(text: str) -> bool:
    try:
        _number(text)
    except (ValueError, IndexError):
        return False
    return True


def _are_numbered(names: list[str]) -> bool:
    """True if the cells of a first line are 0, 1, 2, ... or 1, 2, 3, ...: names, not values."""
    return len(names) > 2 and any(
        names == [str(k + first) for k in range(len(names))] for first in (0, 1)
    )


def _refuse_text(column: NDArray[Any], rows: Rows) -> None:
    if column.dtype.kind == "U":
        texts = column.tolist()
        wrong = next(k for k, text in enumerate(texts) if not _is_number(text))
        raise ValueError(f"line {rows[wrong][0]} holds something else than numbers")


def _excel(path: Path) -> Arrays:
    with zipfile.ZipFile(path) as archive:
        _refuse_expansion(archive, path)
    sheets = pd.read_excel(path, sheet_name=None, header=None, dtype=object, engine="openpyxl")
    found: Arrays = {}
    filled = {str(name): sheet for name, sheet in sheets.items() if not sheet.empty}
    for name, sheet in filled.items():
        rows = [
            (k, ["" if pd.isna(cell) else str(cell) for cell in row])
            for k, row in enumerate(sheet.to_numpy().tolist(), 1)
        ]
        arrays = _table([row for row in rows if any(row[1])])
        found |= arrays if len(filled) == 1 else {f"{name}/{n}": a for n, a in arrays.items()}
    return found


def _matlab(path: Path) -> Arrays:
    if _is_hdf5(path):
        # MATLAB stores columns first, as HDF5 does not know.
        return {name: array.T for name, array in _hdf5(path).items()}
    found = all_variables(path)
    if all(value is None for value in found.values()):
        raise ValueError(
            "it holds no arrays: save the parts of structs, cell arrays and sparse matrices as "
            "arrays of their own (save -struct)"
        )
    return {name: UNREAD if value is None else np.asarray(value) for name, value in found.items()}


def _is_hdf5(path: Path) -> bool:
    """True for a MATLAB file of version 7.3."""
    with path.open("rb") as file:
        return file.read(512 + len(_HDF5)).endswith(_HDF5)


def _npy(path: Path) -> Arrays:
    try:
        return {TABLE: np.array(np.load(path, mmap_mode="r", allow_pickle=False))}
    except ValueError as error:
        raise ValueError(
            "it is damaged, or holds Python objects: save plain numbers with numpy.save"
        ) from error


def _npz(path: Path) -> Arrays:
    if not zipfile.is_zipfile(path):
        raise ValueError("it is damaged, or was not written by numpy.savez")
    with zipfile.ZipFile(path) as archive:
        _refuse_expansion(archive, path)
    with np.load(path, allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    return {name: a if a.dtype.kind in "biufcU" else UNREAD for name, a in found.items()}


def _refuse_expansion(archive: zipfile.ZipFile, path: Path) -> None:
    if sum(member.file_size for member in archive.infolist()) > most_bytes(path):
        raise ValueError("it claims to be much larger than the file")


def _hdf5(path: Path) -> Arrays:
    import h5py

    found: Arrays = {}
    most = most_bytes(path)

    def keep(name: str, part: Any) -> None:
        if not isinstance(part, h5py.Dataset) or name.startswith("#"):  # MATLAB's own
            return
        if "MATLAB_empty" in part.attrs:  # its values are the sizes
            found[name] = np.empty((0, 0))
            return
        if part.attrs.get("MATLAB_class") == b"char":
            letters = np.asarray(own_dataset(part.file, name, most)[()], "<u2")
            text = text_lines(letters.tobytes().decode("utf-16-le"), list(letters.shape[::-1]))
            found[name] = UNREAD if text is None else np.asarray(text)
            return
        parts = part.dtype.names or ()
        if part.dtype.kind in "biufc" or set(parts) == {"real", "imag"}:
            array = np.asarray(own_dataset(part.file, name, most)[()])
            found[name] = array["real"] + 1j * array["imag"] if parts else array
        else:
            found[name] = UNREAD

    with h5py.File(path, "r") as file:
        if file.attrs.get("format") == layout.FORMAT.encode():
            raise ValueError("it is a recording already")
        file.visititems(keep)
    return found


READERS: dict[str, Callable[[Path], Arrays]] = {
    ".csv": _text,
    ".tsv": _text,
    ".txt": _text,
    ".mat": _matlab,
    ".npy": _npy,
    ".npz": _npz,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".xlsx": _excel,
}
"""Readers by the ending of a file's name."""
