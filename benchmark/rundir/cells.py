"""Cells of a run, and the batches of answers that are stored of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.rundir.file_names import file_name

Values = Mapping[str, NDArray[Any]]
"""Arrays with a row for each of some samples, by name."""


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

    @property
    def folders(self) -> tuple[str, str]:
        """Names of the folders of its scenario and of itself, fit for any system."""
        # No name holds a slash.
        own = f"{self.name}/{self.variant}" if self.variant else self.name
        return file_name(self.scenario), file_name(own)


@dataclass(frozen=True, eq=False)
class Batch:
    """Answers of a cell to some samples.

    Attributes:
        start: position of its first sample in the data set.
        status, message: k texts each.
        values: arrays (k, ...), NaN where there is no valid answer.
        state: what its cell remembers by then, as JSON; see `run.cell.CellState`.
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

    def write(self, path: Path) -> None:
        """Write an NPZ file that `read` reads."""
        with path.open("wb") as file:  # a path without .npz would get another name
            np.savez(
                file,
                status=np.array(self.status, dtype=np.str_),
                message=np.array(self.message, dtype=np.str_),
                state=np.array(self.state),
                **dict[str, Any](self.values),
            )

    @classmethod
    def read(cls, path: Path, start: int) -> "Batch":
        """Read the batch at `path`, whose first sample is at `start`.

        Raises:
            Exception: whatever the damage of archives and headers leads to.
        """
        with ZipFile(path) as archive:  # nothing that `write` writes is compressed
            if sum(member.file_size for member in archive.infolist()) > path.stat().st_size:
                raise ValueError("it claims to hold more than the file")
        with np.load(path, allow_pickle=False) as arrays:
            values = dict(arrays)
        status, message = (values.pop(name) for name in ("status", "message"))
        state = str(values.pop("state"))
        if any(len(array) != len(status) for array in values.values()):
            raise ValueError("its arrays are of unlike lengths")
        return cls(start, list(map(str, status)), list(map(str, message)), values, state)
