"""The HDF5 file of a finished run: the truth of every scenario, and the answers of every cell.

A group `<scenario>/<TRUTH>` holds the truth, a group `<scenario>/<name>` the answers of a method or
operator with the numbers of their samples, and in `validation` the images of the validation presses
that registered a method with the robot, where there are such.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.rundir.cells import Batch, Cell, Values
from eitbench.benchmark.rundir.few_bytes import unpacked
from eitbench.scenarios.errors import DataCorruptError, EitbenchError
from eitbench.scenarios.sensors.sensor_file import MAX_PIXELS
from eitbench.scenarios.storage.limits import own_dataset

TRUTH = "truth"  # which no method may be called
MOST_MEASUREMENTS = 2**16
"""Of a frame."""
MOST_BYTES = 2**32
"""Of the images of a cell in memory."""
CHUNK = 6400  # values read at once: one image of 80 x 80 pixels

Bounds = tuple[float, float, float, float]
Truth = tuple[Mapping[str, Any], Values]
"""Known of a scenario: attributes and arrays by name."""


def write_arrays(
    path: Path,
    truths: Mapping[str, Truth],
    cells: Iterable[tuple[Cell, NDArray[np.int64], Iterable[Batch], Sequence[Batch]]],
    array: str,
) -> None:
    """Write the file of arrays of a run to `path`.

    Args:
        path: of the new file.
        truths: by scenario, in the order of the file.
        cells: with the numbers of their samples, their batches, one in memory at a time, and those
            of validation.
        array: name of what is stored of the values of a batch.
    """
    with h5py.File(path, "w") as file:
        for scenario, (attributes, arrays) in truths.items():
            group = file.create_group(f"{scenario}/{TRUTH}")
            group.attrs.update(attributes)
            for name, values in arrays.items():
                layout = _compression(values.shape) if values.ndim > 1 else {}
                group.create_dataset(name, data=values, **layout)
        for cell, numbers, batches, validation in cells:
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
            if validation:
                images = np.concatenate([batch.values[array] for batch in validation])
                group.create_dataset("validation", data=images, **_compression(images.shape))


def _compression(shape: tuple[int, ...]) -> dict[str, Any]:
    if 0 in shape:
        return {}
    return {
        "chunks": (min(shape[0], max(1, CHUNK // math.prod(shape[1:]))), *shape[1:]),
        "compression": "gzip",
        "compression_opts": 1,
        "shuffle": True,
    }


@dataclass(frozen=True, eq=False)
class Scene:
    """Geometry, background and truth of the images of a scenario.

    Attributes:
        bounds: (x_min, y_min, x_max, y_max) [m].
        background: conductivity of the untouched sensor [S/m].
        data_range: [S/m].
        mask: (H, W) pixels of the sensor.
        sample: (n,) sample numbers of `truth`.
        truth: (n, H, W) true conductivity [S/m], or classes (n, h, w) on the same ground; None
            where neither is known.
        has_classes: True if `truth` holds classes: -1 resistive, 0, +1 conductive.
    """

    bounds: Bounds
    background: float
    data_range: float
    mask: NDArray[np.bool_]
    sample: NDArray[np.int64]
    truth: NDArray[np.float64] | None
    has_classes: bool


def read_scene(path: Path, scenario: str, samples: Sequence[int], n: int) -> Scene:
    """Read from the file at `path` what is known of a scenario, with the truth of `samples`.

    Args:
        n: number of samples of the scenario; the file may hold no more.

    Raises:
        DataCorruptError: the file does not hold it, or is damaged.
    """
    with _group(path, scenario, TRUTH) as group:
        numbers, mask = _numbers(group, n), own_dataset(group, "mask", MAX_PIXELS**2)[:]
        rows = _rows_of(numbers, samples)
        names = [name for name in ("conductivity", "classes") if name in group]
        truth = None
        if names:
            of_classes = names == ["classes"]  # their pixels may be finer than the sensor's
            most = n * MAX_PIXELS**2 if of_classes else 8 * n * mask.size
            images = own_dataset(group, names[0], most)
            shape = images.shape[1:] if of_classes and images.ndim == 3 else mask.shape
            if images.shape != (len(numbers), *shape):
                raise ValueError("images and mask are of unlike shapes")
            _check_memory(len(rows), shape, 8)
            truth = _images(images, rows)
        x0, y0, x1, y1 = (float(value) for value in group.attrs["bounds"])
        background = float(group.attrs["background"])
        if not (0 < x1 - x0 < math.inf and 0 < y1 - y0 < math.inf and 0 < background < math.inf):
            raise ValueError("it has no bounds or no background")
        if mask.ndim != 2 or not mask.any():
            raise ValueError("its mask has no pixel")
        return Scene(
            bounds=(x0, y0, x1, y1),
            background=background,
            data_range=float(group.attrs["data_range"]),
            mask=mask.astype(bool),
            sample=numbers[rows],
            truth=truth,
            has_classes=names == ["classes"],
        )


def read_estimates(
    path: Path, scenario: str, method: str, samples: Sequence[int], n: int
) -> NDArray[np.float32] | None:
    """Read conductivity (k, H, W) [S/m] of `samples`, NaN where there was no valid output.

    None where the file holds none of these samples of this method.

    Args:
        n: number of samples of the scenario; the file may hold no more.

    Raises:
        DataCorruptError: the file holds nothing of this method, or is damaged.
    """
    with _group(path, scenario, TRUTH) as group:
        shape = own_dataset(group, "mask", MAX_PIXELS**2).shape
    with _group(path, scenario, method) as group:
        numbers = _numbers(group, n)
        stored = own_dataset(group, "conductivity", 4 * n * math.prod(shape))
        if stored.shape != (len(numbers), *shape):
            raise ValueError("there is not an image for each sample")
        known = np.isin(samples, numbers)
        if not known.any():
            return None
        _check_memory(len(samples), shape, 4)
        images = np.full((len(samples), *stored.shape[1:]), np.nan, np.float32)
        images[known] = _images(stored, _rows_of(numbers, np.array(samples)[known]))
        return images


def read_validation(
    path: Path, scenario: str, method: str, shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Read the images (k, H, W) [S/m] of `shape` that a method was registered with the robot by.

    Raises:
        DataCorruptError: the file does not hold them, or is damaged.
    """
    with _group(path, scenario, method) as group:
        stored = own_dataset(group, "validation", 4 * math.prod(shape))
        if stored.shape != shape:
            raise ValueError("there is not an image for each validation press")
        return np.asarray(stored[:], dtype=np.float32)


STEPS = 1024
"""Into at least so many the largest contrast of an image is divided where it is rounded."""


def rounded_images(
    images: NDArray[np.float32], background: float
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Round conductivity (n, H, W) [S/m] to steps of a share of each image's largest contrast.

    A step is the largest power of 2 that is at most 1 / `STEPS` of that contrast: a touch that
    changes little keeps as many levels as a strong one.

    Returns:
        The images, and their steps (n, 1, 1) [S/m].
    """
    contrast = images.astype(np.float64) - background
    largest = np.abs(contrast).max(
        axis=(1, 2), keepdims=True, where=np.isfinite(contrast), initial=0
    )
    steps = np.ldexp(1.0, np.frexp(largest)[1] - 1) / STEPS
    return (background + np.round(contrast / steps) * steps).astype(np.float32), steps


def _unreadable(path: Path) -> DataCorruptError:
    return DataCorruptError(
        f"{path} is {'damaged' if path.exists() else 'missing'}: run the suite again, or take the "
        "run directory again from where it came from."
    )


def names_in(path: Path) -> Iterator[str]:
    """Yield the names of all that the file at `path` holds, as far down as a run writes.

    A group or dataset is "SCENARIO", "SCENARIO/NAME" or "SCENARIO/NAME/ARRAY", and an attribute is
    "@ATTRIBUTE" in its place, such as "SCENARIO/NAME/@ATTRIBUTE".

    Raises:
        DataCorruptError: the file is damaged.
    """
    try:
        with h5py.File(path, "r") as file:
            yield from _names_in(file, "", 3)
    # HDF5 fails in whatever way the damage leads to.
    except Exception as error:
        raise _unreadable(path) from error


def _names_in(part: h5py.Group | h5py.Dataset, prefix: str, levels: int) -> Iterator[str]:
    for name in part.attrs:
        yield f"{prefix}@{name}"
    for name in part if isinstance(part, h5py.Group) else ():
        yield prefix + name
        if levels and isinstance(part.get(name, getlink=True), h5py.HardLink):
            yield from _names_in(part[name], f"{prefix}{name}/", levels - 1)


TOUCHES_KEPT = 200
"""Images of touches in a run of operators: all of them would be large."""


def read_touch(
    path: Path, scenario: str, sample: int, n: int
) -> tuple[NDArray[np.float64], Bounds]:
    """Read the true conductivity (H, W) [S/m] of one of the first of `n` samples of operators.

    Returns:
        The image, and its bounds (x_min, y_min, x_max, y_max) [m].

    Raises:
        DataCorruptError: the file does not hold it, or is damaged.
    """
    with _group(path, scenario, TRUTH) as group:
        images = own_dataset(group, "conductivity", 8 * TOUCHES_KEPT * MAX_PIXELS**2)
        (row,) = _rows_of(_numbers(group, n)[: len(images)], [sample])
        x0, y0, x1, y1 = (float(value) for value in group.attrs["bounds"])
        return images[row].astype(np.float64), (x0, y0, x1, y1)


def read_responses(
    path: Path, scenario: str, operators: Sequence[str], sample: int, n: int
) -> dict[str, NDArray[np.float64]]:
    """Read the responses (M,) to the touch of one of `n` samples [V/A], by operator.

    That of the exact model is `TRUTH`. A response is the voltages minus those of the untouched
    sensor, by the exact model.

    Raises:
        DataCorruptError: the file does not hold them, or is damaged.
    """
    found: dict[str, NDArray[np.float64]] = {}
    reference = np.zeros(0)
    for name in (TRUTH, *operators):
        with _group(path, scenario, name) as group:
            (row,) = _rows_of(_numbers(group, n), [sample])
            if name == TRUTH:
                reference = own_dataset(group, "reference", 8 * MOST_MEASUREMENTS)[:]
            voltages = own_dataset(group, "voltages", 8 * n * reference.size)[row]
            found[name] = np.asarray(voltages - reference, dtype=np.float64)
    return found


_OPEN: ContextVar[Mapping[Path, h5py.File]] = ContextVar("_OPEN", default=MappingProxyType({}))


@contextmanager
def kept_open(path: Path) -> Iterator[None]:
    """Keep the file at `path` open for this thread: to open it takes as long as to read an image.

    Who reads from it in the block is told if it is not there, or damaged.
    """
    with ExitStack() as opened:
        before = _OPEN.get()
        if path not in before:
            with suppress(Exception):  # as of `_group`
                file = opened.enter_context(h5py.File(path, "r"))
                opened.callback(_OPEN.reset, _OPEN.set({**before, path: file}))
        yield


@contextmanager
def _group(path: Path, scenario: str, name: str) -> Iterator[h5py.Group]:
    """Open a group of the file at `path`; damage of any kind is one sentence."""
    try:
        kept = _OPEN.get().get(path)
        with h5py.File(path, "r") if kept is None else nullcontext(kept) as file:
            group = file
            for part in (scenario, name):
                if not isinstance(group.get(part, getlink=True), h5py.HardLink):
                    raise DataCorruptError(
                        f"{path} holds no images of {name!r} on scenario {scenario!r}: resume the "
                        "run."
                    )
                group = group[part]
            yield group
    except EitbenchError:
        raise
    # HDF5 fails in whatever way the damage leads to.
    except Exception as error:
        raise _unreadable(path) from error


def _images(stored: h5py.Dataset, rows: Sequence[int]) -> NDArray[np.float64]:
    """Read images (k, H, W) of these rows; those of a record are packed."""
    images = stored[rows]
    if "step" not in stored.attrs:
        return np.asarray(images, dtype=np.float64)
    step = float(stored.attrs["step"])
    if images.dtype != np.uint16 or not 0 < step < math.inf:
        raise ValueError("its images are not packed as those of records are")
    return unpacked(images, step)


def _check_memory(n: int, shape: tuple[int, ...], bytes_a_pixel: int) -> None:
    if n * math.prod(shape) * bytes_a_pixel > MOST_BYTES:
        raise ValueError(f"its images take more than {MOST_BYTES:,} bytes")


def _numbers(group: h5py.Group, n: int) -> NDArray[np.int64]:
    """Sample numbers of the images of a group, at most `n`."""
    stored = own_dataset(group, "sample", 8 * n)
    if stored.dtype.kind not in "iu" or stored.ndim != 1:
        raise ValueError("samples are not numbered")
    return np.asarray(stored[:], dtype=np.int64)


def _rows_of(numbers: NDArray[np.int64], samples: Iterable[int]) -> list[int]:
    """Row numbers of the given samples, rising as HDF5 wants them; samples are stored in order."""
    return sorted(np.flatnonzero(np.isin(numbers, list(samples))).tolist())
