"""Results of the samples of one batch, and of all stored batches of a cell."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.rundir.cells import Batch, Cell, Values
from eitbench.benchmark.rundir.store import RunStore
from eitbench.benchmark.workers.worker import Failure

Blank = Callable[[int], dict[str, NDArray[np.generic]]]
"""Arrays of so many samples without an answer."""


class BatchResult:
    """The samples of one batch in order, good and bad, as they are collected."""

    def __init__(self, blank: Blank) -> None:
        self._blank = blank
        self._values: list[Values | None] = []
        self._status: list[str] = []
        self._message: list[str] = []

    def __len__(self) -> int:
        return len(self._status)

    def add(self, values: Values, good: NDArray[np.bool_]) -> None:
        """Add answered samples, of which those that are not `good` hold no valid output."""
        for k, valid in enumerate(good):
            self._values.append({name: array[k] for name, array in values.items()})
            self._status.append("ok" if valid else "invalid-output")
            self._message.append("" if valid else "returned values that are not finite")

    def take(self, batch: Batch) -> None:
        """Add samples that are stored already."""
        names = batch.values.keys()
        self._values += [{name: batch.values[name][k] for name in names} for k in range(len(batch))]
        self._status += batch.status
        self._message += batch.message

    def fail(self, count: int, failure: Failure) -> "BatchResult":
        """Add `count` samples that were lost to `failure`."""
        self._values += [None] * count
        self._status += [failure.status] * count
        self._message += [failure.message] * count
        return self

    def batch(self, start: int, state: str) -> Batch:
        """Return the batch that is stored, with the `state` of its cell."""
        arrays = self._blank(len(self))
        for k, values in enumerate(self._values):
            for name, value in (values or {}).items():
                arrays[name][k] = value
        return Batch(start, self._status, self._message, arrays, state)


class StoredBatches:
    """All stored samples of one split of a cell, in the order of the data set.

    Attributes:
        values: arrays (n, ...).
        status, message: n texts; status "" where nothing is stored.
    """

    def __init__(self, store: RunStore, cell: Cell, split: str, n: int, blank: Blank) -> None:
        self.values = blank(n)
        self.status = np.full(n, "", dtype=object)
        self.message = np.full(n, "", dtype=object)
        for batch in store.batches(cell, split):
            rows = slice(batch.start, batch.stop)
            self.status[rows] = batch.status
            self.message[rows] = batch.message
            for name, array in self.values.items():
                array[rows] = batch.values[name]
