"""The HDF5 file of a finished run: what is known of every scenario, and the answers of every cell.

A group `<scenario>/<TRUTH>` holds the truth, a group `<scenario>/<name>` the answers of a method or
operator with the numbers of their samples.
"""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.rundir.cells import Batch, Cell, Values
from eitbench.methods.registry import RESERVED

TRUTH = RESERVED
CHUNK = 6400  # values read at once: one image of 80 x 80 pixels

Truth = tuple[Mapping[str, Any], Values]
"""Known of a scenario: attributes and arrays by name."""


def write_arrays(
    path: Path,
    truths: Mapping[str, Truth],
    cells: Iterable[tuple[Cell, NDArray[np.int64], Iterable[Batch]]],
    array: str,
) -> None:
    """Write the file of arrays of a run to `path`.

    Args:
        path: of the new file.
        truths: by scenario, in the order of the file.
        cells: with the numbers of their samples and their batches, one in memory at a time.
        array: name of what is stored of the values of a batch.
    """
    with h5py.File(path, "w") as file:
        for scenario, (attributes, arrays) in truths.items():
            group = file.create_group(f"{scenario}/{TRUTH}")
            group.attrs.update(attributes)
            for name, values in arrays.items():
                layout = _compression(values.shape) if values.ndim > 1 else {}
                group.create_dataset(name, data=values, **layout)
        for cell, numbers, batches in cells:
            group = file.create_group(f"{cell.scenario}/{cell.name}")
            group["sample"] = numbers
            row, stored = 0, None
            for batch in batches:
                values = batch.values[array]
                if stored is None:
                    shape = (len(numbers), *values.shape[1:])
                    stored = group.create_dataset(array, shape, values.dtype, **_compression(shape))
                stored[row : row + len(values)] = values
                row += len(values)


def _compression(shape: tuple[int, ...]) -> dict[str, Any]:
    if 0 in shape:
        return {}
    return {
        "chunks": (min(shape[0], max(1, CHUNK // math.prod(shape[1:]))), *shape[1:]),
        "compression": "gzip",
        "compression_opts": 1,
        "shuffle": True,
    }
