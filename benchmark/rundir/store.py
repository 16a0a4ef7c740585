"""The run directory: rows that survive an interruption, and the files that a finished run holds.

While a run is going, every batch of samples is written to `parts/<scenario>/<method>/` as soon as
it is answered, and every finished cell (scenario x method, or x operator) adds its scored rows.
`assemble` turns parts into `samples.parquet`, the table of cells and the file of arrays; each file
appears whole or not at all.
"""

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote
from zipfile import ZipFile

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.rundir import lock, manifest
from eitbench.benchmark.rundir.kinds import RunKind
from eitbench.benchmark.rundir.tables import read_parquet, write_parquet
from eitbench.methods.registry import RESERVED
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError

SAMPLES = "samples.parquet"
TRACKS = "tracks.parquet"
TRUTH = RESERVED
MAX_FOLDER = 120
CHUNK = 6400  # values read at once: one image of 80 x 80 pixels

Values = Mapping[str, NDArray[Any]]
"""Arrays with a row for each of some samples, by name."""
Files = Mapping[str, bytes]
"""What is kept of a cell: the content of its files by name."""
Truth = tuple[Mapping[str, Any], Values]
"""What is known of a scenario: attributes and arrays by name."""


@dataclass(frozen=True)
class Cell:
    """One scenario with one method or operator, `name`.

    Attributes:
        variant: tells the cells of other tracks from that which is ranked, whose variant is "".
    """

    scenario: str
    name: str
    variant: str = ""

    def __str__(self) -> str:
        return "--".join((self.scenario, self.name, *([self.variant] if self.variant else [])))


@dataclass(frozen=True, eq=False)
class Batch:
    """What became of some samples of a cell.

    Attributes:
        start: position of its first sample in the data set.
        status, message: k texts each.
        values: arrays (k, ...), NaN where there is no valid answer.
        state: what its cell remembers by then, as JSON; see `cell_run.CellState`.
    """

    start: int
    status: Sequence[str]
    message: Sequence[str]
    values: Values
    state: str

    def __len__(self) -> int:
        """Number of samples k."""
        return len(self.status)

    @property
    def stop(self) -> int:
        """Position after its last sample."""
        return self.start + len(self.status)


class RunStore:
    """Reads and writes one run directory of one kind."""

    def __init__(self, path: Path, kind: RunKind) -> None:
        self.path = path
        self.kind = kind

    @classmethod
    def create(cls, path: Path, kind: RunKind) -> "RunStore":
        """A new, empty run directory, or one in which a run was ended before it had begun.

        Raises:
            InputError: `path` holds something already or is not a folder.
            EitbenchError: it cannot be written.
        """
        if path.exists() and not path.is_dir():
            raise InputError(f"The output {path} is a file: choose a folder with --out.")
        if path.is_dir() and not _unused(path):
            raise InputError(
                f"The output folder {path} is not empty: choose another with --out, or continue "
                f"a run in it with `eitbench run --resume {path}`."
            )
        with _said(path):
            (path / "logs").mkdir(parents=True, exist_ok=True)
        return cls(path, kind)

    def discard(self) -> None:
        """Remove a run directory in which nothing has happened."""
        shutil.rmtree(self.path, ignore_errors=True)

    def log(self, cell: Cell) -> Path:
        """Where what runs in a cell writes what it prints."""
        return self.path / "logs" / f"{_folder(cell.scenario)}--{_cell_folder(cell)}.log"

    def write_manifest(self, content: manifest.Manifest) -> None:
        """Replace the manifest."""
        text = json.dumps(content, indent=2, allow_nan=False, default=str) + "\n"
        self._replace(self.path / manifest.FILE_NAME, lambda part: _write_text(part, text))

    def write_samples(self, samples: pd.DataFrame) -> None:
        """Replace the rows of a finished run."""
        self._replace(self.path / SAMPLES, partial(write_parquet, samples))

    def save_batch(self, cell: Cell, split: str, batch: Batch) -> None:
        """Keep the outcome of a batch."""
        self._replace(
            self._batch_path(cell, split, batch.start),
            lambda part: np.savez(
                part,
                status=np.array(batch.status, dtype=np.str_),
                message=np.array(batch.message, dtype=np.str_),
                state=np.array(batch.state),
                **dict[str, Any](batch.values),
            ),
        )

    def batch(self, cell: Cell, split: str, start: int) -> Batch:
        """The batch kept at `start`.

        Raises:
            DataCorruptError: it cannot be read.
        """
        path = self._batch_path(cell, split, start)
        try:
            values = _read_arrays(path)
            status, message = (values.pop(name) for name in ("status", "message"))
            state = str(values.pop("state"))
            if any(len(values[name]) != len(status) for name in values):
                raise ValueError("its arrays are of unlike lengths")
            return Batch(start, list(map(str, status)), list(map(str, message)), values, state)
        # Damaged archives and headers fail in whatever way the damage leads to.
        except Exception as error:
            raise _unreadable(path, error) from error

    def batches(self, cell: Cell, split: str) -> Iterator[Batch]:
        """The batches kept of a cell, in order, one in memory at a time."""
        for path in sorted(self._parts(cell).glob(f"{split}-*.npz")):
            yield self.batch(cell, split, int(path.stem.rpartition("-")[2]))

    def batch_length(self, cell: Cell, split: str, start: int) -> int:
        """How many samples are kept of the batch at `start`.

        Raises:
            DataCorruptError: it cannot be read.
        """
        path = self._batch_path(cell, split, start)
        if not path.is_file():
            return 0
        try:
            return len(_read_arrays(path, ["status"])["status"])
        except Exception as error:
            raise _unreadable(path, error) from error

    def has_batches(self, cell: Cell) -> bool:
        """Whether any test batch of the cell is kept."""
        return any(self._parts(cell).glob("test-*.npz"))

    def save_cell(self, cell: Cell, samples: pd.DataFrame, row: dict[str, Any]) -> None:
        """Keep the scored rows of a cell, and its own row."""
        folder = self._parts(cell)
        self._replace(folder / SAMPLES, partial(write_parquet, samples))
        # Written last: its presence says that the cell is scored.
        table = pd.DataFrame([row])
        self._replace(folder / self.kind.table, partial(write_parquet, table))

    def scored(self, cell: Cell) -> bool:
        """Whether the cell has rows, be it of some of its frames only."""
        return all((self._parts(cell) / name).is_file() for name in (SAMPLES, self.kind.table))

    def finished(self, cell: Cell) -> bool:
        """Whether every frame of the cell has its scored row.

        Raises:
            DataCorruptError: the rows cannot be read.
        """
        if not self.scored(cell):
            return False
        return bool(
            _read_table(self._parts(cell) / self.kind.table, "complete")["complete"].iloc[0]
        )

    def assemble(self, cells: Sequence[Cell], truths: Mapping[str, Truth]) -> None:
        """Write the result files from the parts of all `cells` that have scored rows."""
        scored = [cell for cell in cells if self.scored(cell)]
        kind, folders = self.kind, [self._parts(cell) for cell in scored]
        samples = _concatenate([_read_table(folder / SAMPLES, "sample") for folder in folders])
        rows = _concatenate([_read_table(folder / kind.table, "complete") for folder in folders])
        rows = rows.drop(columns="complete", errors="ignore")
        self.write_samples(samples)
        self._replace(self.path / kind.table, partial(write_parquet, rows))
        self._replace(
            self.path / kind.arrays, lambda part: self._write_arrays(part, scored, truths)
        )

    def pack(self, cell: Cell) -> Files:
        """What is kept of a cell, to be sent elsewhere."""
        folder = self._parts(cell)
        there = sorted(folder.iterdir()) if folder.is_dir() else []
        return {path.name: path.read_bytes() for path in there if not path.name.startswith(".")}

    def unpack(self, cell: Cell, files: Files) -> None:
        """Keep what was packed elsewhere, and nothing else of the cell."""
        folder = self._parts(cell)
        # As where it was written: the table of the cell, which says that it is scored, comes last.
        for name in sorted(files, key=lambda name: (name == self.kind.table, name)):
            path = folder / Path(name).name
            if not path.is_file() or path.read_bytes() != files[name]:
                self._replace(path, partial(_write_bytes, files[name]))
        for name in self.pack(cell).keys() - files.keys():
            (folder / name).unlink(missing_ok=True)

    def rows(self, cell: Cell) -> pd.DataFrame:
        """The scored rows of a cell.

        Raises:
            DataCorruptError: they cannot be read.
        """
        return _read_table(self._parts(cell) / SAMPLES, "sample")

    def write_tracks(self, rows: pd.DataFrame) -> None:
        """Replace the rows of the tracks that are not ranked."""
        self._replace(self.path / TRACKS, partial(write_parquet, rows))

    def forget_answers(self, cell: Cell) -> None:
        """Remove the answers that are kept of a scored cell, but not its rows."""
        for path in self._parts(cell).glob("*.npz"):
            path.unlink(missing_ok=True)

    def forget(self, cell: Cell) -> None:
        """Remove what is kept of a cell."""
        shutil.rmtree(self._parts(cell), ignore_errors=True)

    def remove_parts(self) -> None:
        """Forget the parts of a run that is assembled."""
        shutil.rmtree(self.path / "parts", ignore_errors=True)

    def _write_arrays(self, path: Path, cells: Sequence[Cell], truths: Mapping[str, Truth]) -> None:
        with h5py.File(path, "w") as file:
            for name in dict.fromkeys(cell.scenario for cell in cells):
                _write_group(file.create_group(f"{name}/{TRUTH}"), *truths[name])
            for cell in cells:
                numbers = _read_table(self._parts(cell) / SAMPLES, "sample")["sample"]
                group = file.create_group(f"{cell.scenario}/{cell.name}")
                group["sample"] = numbers.to_numpy(np.int64)
                row, stored = 0, None
                for batch in self.batches(cell, "test"):
                    values = batch.values[self.kind.array]
                    if stored is None:
                        shape = (len(numbers), *values.shape[1:])
                        stored = group.create_dataset(
                            self.kind.array, shape, values.dtype, **_compression(shape)
                        )
                    stored[row : row + len(values)] = values
                    row += len(values)

    def _parts(self, cell: Cell) -> Path:
        return self.path / "parts" / _folder(cell.scenario) / _cell_folder(cell)

    def _batch_path(self, cell: Cell, split: str, start: int) -> Path:
        return self._parts(cell) / f"{split}-{start:08d}.npz"

    def _replace(self, path: Path, write: Callable[[Path], None]) -> None:
        """Write a file beside its place, then move it there in one step."""
        part = _part(path)
        with _said(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                write(part)
                _flush(part)
                part.replace(path)
            finally:
                part.unlink(missing_ok=True)


def _write_group(group: h5py.Group, attributes: Mapping[str, Any], arrays: Values) -> None:
    group.attrs.update(attributes)
    for name, array in arrays.items():
        layout = _compression(array.shape) if array.ndim > 1 else {}
        group.create_dataset(name, data=array, **layout)


def _compression(shape: tuple[int, ...]) -> dict[str, Any]:
    if 0 in shape:
        return {}
    return {
        "chunks": (min(shape[0], max(1, CHUNK // math.prod(shape[1:]))), *shape[1:]),
        "compression": "gzip",
        "compression_opts": 1,
        "shuffle": True,
    }


def _concatenate(tables: list[pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def _unused(path: Path) -> bool:
    """Whether nothing is in the folder but what a run leaves that was killed as it began."""
    left = (lock.FILE_NAME, _part(path / manifest.FILE_NAME).name)
    return all(
        there.name in left or (there.name == "logs" and there.is_dir() and not any(there.iterdir()))
        for there in path.iterdir()
    )


def _part(path: Path) -> Path:
    """Where a file is written before it is moved to `path`."""
    return path.with_name(f".{path.name}.part{path.suffix}")


def _read_arrays(path: Path, names: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """All or some arrays of an NPZ file as `np.savez` writes it: nothing in it is compressed."""
    with ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > path.stat().st_size:
            raise ValueError("it claims to hold more than the file")
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in names or arrays.files}


def _read_table(path: Path, column: str) -> pd.DataFrame:
    """A table of at least one row that has `column`.

    Raises:
        DataCorruptError: it is not.
    """
    try:
        table = read_parquet(path)
        table[column].iloc[0]
    # Damaged tables fail in whatever way the damage leads to.
    except Exception as error:
        raise _unreadable(path, error) from error
    return table


def _unreadable(path: Path, error: Exception) -> DataCorruptError:
    reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
    return DataCorruptError(f"{path} cannot be read ({reason}): delete it and resume the run.")


def _cell_folder(cell: Cell) -> str:
    # No name holds a slash.
    return _folder(f"{cell.name}/{cell.variant}" if cell.variant else cell.name)


def _folder(name: str) -> str:
    """`name` as one folder name on any system: what could be a path is percent-encoded."""
    quoted = quote(name, safe=" +=@")
    if len(quoted) > MAX_FOLDER:  # file systems limit a name to 255 bytes
        digest = hashlib.sha256(name.encode()).hexdigest()[:16]
        quoted = f"{quoted[: MAX_FOLDER - 17]}~{digest}"
    return "%2E" + quoted[1:] if quoted.startswith(".") else quoted


def _flush(path: Path) -> None:
    """Have a file on the disk, so that it is whole where its name appears, whatever happens."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _write_bytes(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


@contextmanager
def _said(path: Path) -> Iterator[None]:
    """Turn an error of the file system into one sentence."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise EitbenchError(f"Could not write {path}: {reason}.") from error
