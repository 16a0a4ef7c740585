"""The run directory: rows that survive an interruption, and the files that a finished run holds.

While a run is going, every batch of samples is written to `parts/<scenario>/<method>/` as soon as
it is answered, and every finished cell (scenario x method, or x operator) adds its scored rows.
`assemble` turns parts into `samples.parquet`, the table of cells and the file of arrays; each file
appears whole or not at all.
"""

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.rundir import lock, manifest
from eitbench.benchmark.rundir.cells import Batch, Cell
from eitbench.benchmark.rundir.kinds import RunKind
from eitbench.benchmark.rundir.manifest import resume_command
from eitbench.benchmark.rundir.plan import PluginFile
from eitbench.benchmark.rundir.run_arrays import Truth, write_arrays
from eitbench.benchmark.rundir.tables import read_parquet, write_parquet
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.files import sha256_of, writing

SAMPLES = "samples.parquet"
TRACKS = "tracks.parquet"

Files = Mapping[str, bytes]
"""Stored of a cell: the content of its files by name."""


class RunStore:
    """Reads and writes one run directory of one kind.

    It reads no part that was not there at the beginning, or that it did not write itself.
    """

    def __init__(self, path: Path, kind: RunKind) -> None:
        self.path = path
        self.kind = kind
        there = (path / "parts").rglob("*")
        self._digests = {part: sha256_of(part) for part in there if part.is_file()}

    @classmethod
    def create(cls, path: Path, kind: RunKind) -> "RunStore":
        """Make a new, empty run directory, or take one in which a run ended before it had begun.

        Raises:
            InputError: `path` holds something already or is not a folder.
            EitbenchError: it cannot be written.
        """
        if path.exists() and not path.is_dir():
            raise InputError(f"The output {path} is a file: choose a folder with --out.")
        if path.is_dir() and not unused(path):
            raise InputError(
                f"The output folder {path} is not empty: choose another with --out, or continue "
                f"a run in it with `{resume_command(path)}`."
            )
        with writing(path):
            (path / "logs").mkdir(parents=True, exist_ok=True)
        return cls(path, kind)

    def log(self, cell: Cell) -> Path:
        """Path of the file for the output of what runs in a cell."""
        return self.path / "logs" / f"{'--'.join(cell.folders)}.log"

    def write_manifest(self, content: manifest.Manifest) -> None:
        """Replace the manifest."""
        text = json.dumps(content, indent=2, allow_nan=False, default=str) + "\n"
        self._write(self.path / manifest.FILE_NAME, text.encode())

    def keep_plugins(self, plugins: Iterable[PluginFile]) -> None:
        """Put a copy of every plugin into the folder, so that others can run it again."""
        for plugin in plugins:
            self._write(self.path / plugin.kept, plugin.path.read_bytes())

    def write_table(self, name: str, rows: pd.DataFrame, folder: Path | None = None) -> None:
        """Replace a table of the run, or of one of its folders."""
        self._write((folder or self.path) / name, partial(write_parquet, rows))

    def save_batch(self, cell: Cell, split: str, batch: Batch) -> None:
        """Store a batch."""
        self._write(self._batch_path(cell, split, batch.start), batch.write)

    def batch(self, cell: Cell, split: str, start: int) -> Batch:
        """Read the batch stored at `start`.

        Raises:
            DataCorruptError: it cannot be read.
        """
        path = self._batch_path(cell, split, start)
        with _damage_as_sentence(path):
            self._check_own(path)
            return Batch.read(path, start)

    def batches(self, cell: Cell, split: str) -> Iterator[Batch]:
        """Read the batches stored of a cell, in order, one in memory at a time."""
        for path in sorted(self._parts(cell).glob(f"{split}-*.npz")):
            yield self.batch(cell, split, int(path.stem.rpartition("-")[2]))

    def batch_length(self, cell: Cell, split: str, start: int) -> int:
        """Return the number of samples of the batch stored at `start`, 0 where there is none.

        Raises:
            DataCorruptError: it cannot be read.
        """
        there = self._batch_path(cell, split, start).is_file()
        return len(self.batch(cell, split, start)) if there else 0

    def save_cell(self, cell: Cell, samples: pd.DataFrame, row: dict[str, Any]) -> None:
        """Store the scored rows of a cell, and its own row."""
        folder = self._parts(cell)
        self.write_table(SAMPLES, samples, folder)
        # Written last: its presence says that the cell is scored.
        self.write_table(self.kind.table, pd.DataFrame([row]), folder)

    def scored(self, cell: Cell) -> bool:
        """True if the cell has rows, be it of some of its frames only."""
        return all((self._parts(cell) / name).is_file() for name in (SAMPLES, self.kind.table))

    def finished(self, cell: Cell) -> bool:
        """True if every frame of the cell has its scored row.

        Raises:
            DataCorruptError: the rows cannot be read.
        """
        return self.scored(cell) and bool(self._row(cell)["complete"].iloc[0])

    def rows(self, cell: Cell) -> pd.DataFrame:
        """Read the scored rows of a cell.

        Raises:
            DataCorruptError: they cannot be read.
        """
        return self._read_table(cell, SAMPLES, "sample")

    def _row(self, cell: Cell) -> pd.DataFrame:
        return self._read_table(cell, self.kind.table, "complete")

    def _read_table(self, cell: Cell, name: str, column: str) -> pd.DataFrame:
        """Read a table of a cell, of at least one row, that has `column`."""
        path = self._parts(cell) / name
        with _damage_as_sentence(path):
            self._check_own(path)
            table = read_parquet(path)
            table[column].iloc[0]
            return table

    def _check_own(self, path: Path) -> None:
        """Refuse a part that something else has written: a plugin runs as the same user."""
        if self._digests.get(path) != sha256_of(path):
            raise ValueError("it was changed by something else than this run")

    def assemble(self, cells: Sequence[Cell], truths: Mapping[str, Truth]) -> None:
        """Write the result files from the parts of all `cells` that have scored rows."""
        scored = {cell: self.rows(cell) for cell in cells if self.scored(cell)}
        self.write_table(SAMPLES, _concatenate([*scored.values()]))
        ends = _concatenate([self._row(cell) for cell in scored])
        self.write_table(self.kind.table, ends.drop(columns="complete", errors="ignore"))
        known = {cell.scenario: truths[cell.scenario] for cell in scored}
        answers = (
            (
                cell,
                rows["sample"].to_numpy(np.int64),
                self.batches(cell, "test"),
                [*self.batches(cell, "validation")],
            )
            for cell, rows in scored.items()
        )
        self._write(
            self.path / self.kind.arrays,
            lambda path: write_arrays(path, known, answers, self.kind.array),
        )

    def pack(self, cell: Cell) -> Files:
        """Read all that is stored of a cell, to be sent elsewhere."""
        folder = self._parts(cell)
        there = sorted(folder.iterdir()) if folder.is_dir() else []
        return {path.name: path.read_bytes() for path in there if not path.name.startswith(".")}

    def unpack(self, cell: Cell, files: Files) -> None:
        """Store what was packed elsewhere, and nothing else of the cell."""
        folder = self._parts(cell)
        # As where it was written: the table of the cell, which says that it is scored, comes last.
        for name in sorted(files, key=lambda name: (name == self.kind.table, name)):
            path = folder / Path(name).name
            if not path.is_file() or path.read_bytes() != files[name]:
                self._write(path, files[name])
        for name in self.pack(cell).keys() - files.keys():
            (folder / name).unlink(missing_ok=True)

    def forget_answers(self, cell: Cell) -> None:
        """Remove the answers that are stored of a cell, but not its rows."""
        for path in self._parts(cell).glob("*.npz"):
            path.unlink(missing_ok=True)

    def remove_parts(self) -> None:
        """Remove the parts of a run that is assembled, and what a killed process left of files."""
        shutil.rmtree(self.path / "parts", ignore_errors=True)
        for left in self.path.glob(".*.part"):
            left.unlink(missing_ok=True)

    def _parts(self, cell: Cell) -> Path:
        return self.path.joinpath("parts", *cell.folders)

    def _batch_path(self, cell: Cell, split: str, start: int) -> Path:
        return self._parts(cell) / f"{split}-{start:08d}.npz"

    def _write(self, path: Path, content: bytes | Callable[[Path], object]) -> None:
        def write(part: Path) -> None:
            if isinstance(content, bytes):
                part.write_bytes(content)
            else:
                content(part)
            self._digests[path] = sha256_of(part)

        with writing(path):
            atomic_write(path, write)


def _concatenate(tables: list[pd.DataFrame]) -> pd.DataFrame:
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def unused(path: Path) -> bool:
    """True if nothing is in the folder but what a run leaves that was killed as it began."""
    return all(
        there.name == lock.FILE_NAME
        or there.match(f".{manifest.FILE_NAME}.*.part")
        or (there.name == "logs" and there.is_dir() and not any(there.iterdir()))
        for there in path.iterdir()
    )


@contextmanager
def _damage_as_sentence(path: Path) -> Iterator[None]:
    """Turn an error in reading `path` into one sentence."""
    try:
        yield
    # Damaged archives, headers and tables fail in whatever way the damage leads to.
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
        raise DataCorruptError(
            f"{path} cannot be read ({reason}): delete it and resume the run."
        ) from error
