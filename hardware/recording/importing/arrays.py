"""Frames among the arrays of a file: which array, which axes, and which of its values."""

from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.recording.importing.sources import TABLE, Arrays
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.recordings.frames import impossible, peak
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Sensor

Order = Literal["rows", "columns"]
ORDERS: tuple[Order, ...] = ("rows", "columns")
Part = Literal["real", "magnitude"]


_AXES = {"rows": "frame x drive x sense pair", "columns": "sense pair x drive x frame"}


@dataclass(frozen=True)
class Choice:
    """What a user says about the frames of a file; None: it is found out.

    Attributes:
        name: of the array that holds them.
        order: a frame is a row or a column; of a matrix: a drive is.
        part: of complex values.
    """

    name: str | None = None
    order: Order | None = None
    part: Part | None = None


@dataclass(frozen=True, eq=False)
class FoundFrames:
    """Frames in a file.

    Attributes:
        values: (n, M) in the order of the pattern.
        name: of the array that held them.
        how: they were stored, as a part of a sentence.
    """

    values: Array
    name: str
    how: str


@dataclass(frozen=True, eq=False)
class FrameFile:
    """A file with all its arrays, and the frames among them."""

    path: Path
    arrays: Arrays
    frames: FoundFrames


@dataclass(frozen=True, eq=False)
class _Fit:
    name: str
    order: Order
    values: NDArray[Any]  # (n, W)
    kept: Index | None  # the places (M,) of a frame among W values; None for all
    how: str  # a row or column is what, or what its axes are
    rank: int  # the lower, the plainer


def find_frames(arrays: Arrays, sensor: Sensor, path: Path, choice: Choice) -> FoundFrames:
    """The frames in the `arrays` of the file at `path`.

    An array holds frames if its last axis (or first, for frames in columns) has M values, if its
    last two are drives and sense pairs, or the first two of three. Where every drive has a value
    for every sense pair, those that the sensor's pattern leaves out are dropped.

    Raises:
        InputError: no array fits, several do, or values are complex and nobody said what to take.
        DataCorruptError: a value is not a finite number.
    """
    numeric = {name: array for name, array in arrays.items() if array.dtype.kind in "iufc"}
    if choice.name is not None and choice.name not in numeric:
        raise InputError(f"{path} has no array {choice.name!r}; {_inventory(numeric)}")
    wanted = {choice.name: numeric[choice.name]} if choice.name is not None else numeric
    fits = [
        fit
        for name, array in wanted.items()
        for fit in _fits(name, array, sensor.pattern)
        if choice.order in (None, fit.order) or array.squeeze().ndim < 2
    ]
    if not any(array.size for array in numeric.values()):
        raise InputError(
            f"{path} holds no numbers: if it holds no frames, leave it out, for example by "
            "'press*.csv'."
        )
    if not fits:
        raise InputError(
            f"{path} holds no frames of sensor {sensor.name!r}, which have {sensor.n_measurements} "
            f"values each{f', in {choice.order}' if choice.order else ''}: {_inventory(wanted)} "
            "Name the sensor that was measured (--sensor), or save the frames as an array with a "
            "row for each."
        )
    best = [fit for fit in fits if fit.rank == min(fit.rank for fit in fits)]
    names = list(dict.fromkeys(fit.name for fit in best))
    if len(names) > 1 and TABLE not in names:
        raise InputError(
            f"Several arrays of {path} could be frames: say with --frames which one "
            f"({', '.join(names)})."
        )
    name = TABLE if TABLE in names else names[0]
    chosen = [fit for fit in best if fit.name == name]
    if len({(fit.order, fit.how) for fit in chosen}) > 1:
        ways = dict.fromkeys(fit.how for fit in chosen)
        hows = [(order, {fit.how for fit in chosen if fit.order == order}) for order in ORDERS]
        clear = "".join(f"--order {order}, or " for order, of in hows if len(of) == 1)
        raise InputError(
            f"Array {name!r} of {path} has the shape {_shape(arrays[name])}, which fits twice "
            f"({'; '.join(ways)}): {'say ' * bool(clear)}{clear}save it as frames x values."
        )
    fit = chosen[0]
    how = f"array {name!r}, {fit.how}"
    frames = fit.values
    if fit.kept is not None:
        how += _dropped(fit.values, fit.kept, path)
        frames = frames[:, fit.kept]
    values = _real(frames, path, choice.part)
    if (wrong := impossible(values)).size:
        raise DataCorruptError(
            f"{path} cannot be imported: frame {wrong[0]} (counted from 0) holds "
            f"{peak(values[wrong[0]])}. Leave such frames out; where a value is missing in all of "
            "them, as of an electrode without contact, write 0 for it."
        )
    return FoundFrames(values, name, how)


def _real(values: NDArray[Any], path: Path, part: Part | None) -> Array:
    if part is None and np.iscomplexobj(values):
        raise InputError(
            f"The values of {path} are complex, and methods take one real number each: say "
            "--values real or --values magnitude; for both, make two recordings."
        )
    return np.asarray(np.abs(values) if part == "magnitude" else np.real(values), dtype=np.float64)


def _fits(name: str, array: NDArray[Any], pattern: DrivePattern) -> Iterator[_Fit]:
    """All ways in which `array` holds frames."""
    drives = pattern.table[:, :2]
    n_drives = len(np.unique(drives, axis=0))
    drive_major = np.count_nonzero((np.diff(drives, axis=0) != 0).any(axis=1)) == n_drives - 1
    widths: list[tuple[int, Index | None]] = [(pattern.n_measurements, None)]
    if (table := full_table(pattern)) is not None:
        widths.append(table)
    flat = array.reshape(-1) if array.squeeze().ndim < 2 else array
    orders: tuple[tuple[Order, NDArray[Any]], ...] = (("rows", flat), ("columns", flat.T))
    for order, turned in orders[: flat.ndim]:
        *_, before, last = (1, *turned.shape)
        for rank, (width, kept) in enumerate(widths):
            if last == width:
                how = f"a frame is a {order[:-1]}"
                yield _Fit(name, order, turned.reshape(-1, width), kept, how, rank)
            elif drive_major and last * n_drives == width and before % n_drives == 0 != before:
                how = f"a drive is a {order[:-1]}"
                if turned.ndim == 3:
                    how = f"its axes are {_AXES[order]}"
                yield _Fit(name, order, turned.reshape(-1, width), kept, how, 2 + rank)
            if drive_major and turned.ndim == 3 and order == "rows":
                by_frame = np.moveaxis(turned, -1, 0)
                if by_frame.shape[1] == n_drives and by_frame.shape[2] * n_drives == width:
                    how = "its axes are drive x sense pair x frame"
                    yield _Fit(name, order, by_frame.reshape(-1, width), kept, how, 2 + rank)


def _dropped(full: NDArray[Any], kept: Index, path: Path) -> str:
    """What the values (n, W) are that a pattern leaves out."""
    left = np.delete(full, kept, axis=1)
    # A dead channel is 0, too, but not as often as what a board leaves out.
    if left.any() and np.count_nonzero(~full.any(axis=0)) == left.shape[1]:
        raise InputError(
            f"{left.shape[1]} of the {full.shape[1]} values of a frame in {path} are always 0, but "
            "not those that the sensor's pattern leaves out, so that the values are in another "
            "order than in the pattern: correct the pattern in the sensor file."
        )
    zero = "all 0" if not left.any() else f"of at most {np.abs(left).max():.3g} in size"
    return (
        f"; of its {full.shape[1]} values {left.shape[1]} are dropped that the pattern does not "
        f"measure ({zero})"
    )


def full_table(pattern: DrivePattern) -> tuple[int, Index] | None:
    """Where the values of a frame are if every drive has a value for every sense pair.

    Drive by drive; the sense pairs are in the order that all drives agree on.

    Returns:
        The number of all values W, and the places (M,) of those that the pattern measures. None
        where nothing is left out, or where the drives do not tell one order.
    """
    senses: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for src, sink, a, b in pattern.table.tolist():
        senses.setdefault((src, sink), []).append((a, b))
    sorter: TopologicalSorter[tuple[int, int]] = TopologicalSorter()
    for of_drive in senses.values():
        for before, after in pairwise(of_drive):
            sorter.add(after, before)
    order: list[tuple[int, int]] = []
    try:
        sorter.prepare()
    except CycleError:
        return None
    while sorter.is_active():
        ready = sorter.get_ready()
        if len(ready) > 1:
            return None
        order += ready
        sorter.done(*ready)
    width = len(senses) * len(order)
    if not order or width == pattern.n_measurements:
        return None
    place = {pair: k for k, pair in enumerate(order)}
    drive_of = {pair: k for k, pair in enumerate(senses)}
    kept = [
        drive_of[src, sink] * len(order) + place[a, b] for src, sink, a, b in pattern.table.tolist()
    ]
    return width, np.array(kept)


def _inventory(arrays: Arrays) -> str:
    """The arrays and their shapes, as a sentence."""
    shapes = [f"{name} ({_shape(array)})" for name, array in arrays.items()]
    more = f" and {len(shapes) - 12} more" if len(shapes) > 12 else ""
    return f"it holds {', '.join(shapes[:12]) or 'no arrays of numbers'}{more}."


def _shape(array: NDArray[Any]) -> str:
    return " x ".join(map(str, array.shape))
