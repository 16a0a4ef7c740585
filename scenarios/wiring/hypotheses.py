"""Hypotheses of how a board is wired and in which order it sends its values.

A board that was told to drive and measure with pattern T, and whose electrode k is electrode p(k)
of the sensor, measures p(T). A hypothesis is an order of the rows of the nominal pattern, a first
electrode and a direction (a rotation or reflection p of the numbers), and at most one pair of
electrodes that are interchanged.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.sensors.patterns import DrivePattern, independent

Table = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Order:
    """An order of the values of a frame, in the board's own numbers of electrodes.

    Attributes:
        title: for people.
        table: (M, 4) src, sink, a, b.
    """

    title: str
    table: Table


@dataclass(frozen=True)
class Wiring:
    """A hypothesis.

    Attributes:
        order: index of the order in the list of `orders`.
        start: electrode of the sensor that is the board's electrode 0.
        step: 1 where the numbers go in the declared direction, -1 in the other one.
        swapped: the board's two electrodes that are interchanged; empty for none.
    """

    order: int
    start: int
    step: int
    swapped: tuple[int, ...] = ()

    def numbers(self, n_electrodes: int) -> Table:
        """(E,): the electrode of the sensor that is the board's electrode k."""
        return np.asarray(numbers_of([self], n_electrodes)[0])


def numbers_of(wirings: Sequence[Wiring], n_electrodes: int) -> Table:
    """(n, E): of each wiring the electrodes of the sensor that are the board's 0 to E - 1."""
    board = np.tile(np.arange(n_electrodes), (len(wirings), 1))
    pairs = [(k, *of.swapped) for k, of in enumerate(wirings) if of.swapped]
    if pairs:
        row, first, second = np.transpose(pairs)
        board[row, first], board[row, second] = second, first
    start, step = np.transpose([(of.start, of.step) for of in wirings])
    return np.asarray((start[:, None] + step[:, None] * board) % n_electrodes)


@lru_cache(maxsize=16)
def orders(pattern: DrivePattern) -> list[Order]:
    """The orders in which boards send the values of `pattern`, the declared one first.

    Drive-major or sense-major; the sense pairs ascending, descending, or starting at the drive
    (EIDORS: `rotate_meas`); with or without the pairs that share an electrode with the drive;
    whole or only one of each two reciprocal values. An order that sends the same as one before it
    is left out.
    """
    e = int(pattern.table.max()) + 1
    drives = list(dict.fromkeys(map(tuple, pattern.table[:, :2].tolist())))
    senses = sorted(dict.fromkeys(map(tuple, pattern.table[:, 2:].tolist())))
    declared = set(map(tuple, pattern.table.tolist()))
    found: dict[bytes, Order] = {}

    def add(title: str, table: Table) -> None:
        if not len(table):
            return
        half = table[independent(DrivePattern(table))[0]]
        for said, rows in ((title, table), (f"{title}, reciprocal halves only", half)):
            found.setdefault(rows.tobytes(), Order(said, rows))

    add("as declared", np.array(pattern.table))
    for content in ("", ", with driven electrodes", ", without driven electrodes"):
        for major in ("drive", "sense"):
            for along in ("ascending", "from the drive", "descending"):
                rows = np.array([
                    (*drive, *sense)
                    for drive in drives
                    for sense in _along(senses, drive[0], e, along)
                    if _sent((*drive, *sense), declared, content)
                ], dtype=np.int64).reshape(-1, 4)  # fmt: skip
                if major == "sense":
                    places = {sense: k for k, sense in enumerate(_along(senses, 0, e, along))}
                    rank = [places[a, b] for _, _, a, b in rows.tolist()]
                    rows = rows[np.argsort(rank, kind="stable")]
                add(f"{major}-major, sense pairs {along}{content}", rows)
    return list(found.values())


def _along(senses: list[tuple[int, int]], first: int, e: int, along: str) -> list[tuple[int, int]]:
    if along == "from the drive":
        return sorted(senses, key=lambda pair: ((pair[0] - first) % e, pair[1]))
    return senses[::-1] if along == "descending" else senses


def _sent(row: tuple[int, ...], declared: set[tuple[int, ...]], content: str) -> bool:
    if not content:
        return row in declared
    return "without" not in content or not set(row[:2]) & set(row[2:])


def numberings(candidates: list[Order], n_electrodes: int) -> Iterator[Wiring]:
    """Every order with every first electrode in both directions, the declared one first."""
    for order in range(len(candidates)):
        for step in (1, -1):
            for start in range(n_electrodes):
                yield Wiring(order, start, step)


def with_swaps(wiring: Wiring, n_electrodes: int) -> Iterator[Wiring]:
    """`wiring` with each pair of electrodes interchanged."""
    for first in range(n_electrodes):
        for second in range(first + 1, n_electrodes):
            yield Wiring(wiring.order, wiring.start, wiring.step, (first, second))


def meaning(tables: Table, n_electrodes: int, *, magnitudes: bool) -> Table:
    """(..., M): integers that are equal for rows (..., M, 4) that no linear sensor tells apart.

    Driving and measuring may change places (reciprocity), and both pairs may be reversed. The sign
    of a reversed pair is kept up to one sign of the whole frame, unless the board sends magnitudes.
    """
    e = n_electrodes
    drive, sense = np.sort(tables[..., :2], axis=-1), np.sort(tables[..., 2:], axis=-1)
    pairs = np.sort(np.stack([part[..., 0] * e + part[..., 1] for part in (drive, sense)]), axis=0)
    code = pairs[0] * e * e + pairs[1]
    if magnitudes:
        return np.asarray(code)
    reversed_ = (tables[..., 0] > tables[..., 1]) ^ (tables[..., 2] > tables[..., 3])
    return np.asarray(2 * code + (reversed_ ^ reversed_[..., :1]))
