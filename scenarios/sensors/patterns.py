"""Drive patterns: driving and measuring pairs of electrodes, as an (M, 4) table."""

from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Index
from eitbench.scenarios.errors import InputError

Pair = tuple[int, int]


@dataclass(frozen=True, eq=False)
class DrivePattern:
    """The measurements of one frame, in the order a board sends them.

    Attributes:
        table: (M, 4) integers `src, sink, a, b` (0-based electrodes): +1 A into `src`, -1 A out
            of `sink`, V = U[a] - U[b].
        magnitudes: the board reports |V| only, without its sign.

    Raises:
        InputError: a table of the wrong shape, or a pair whose two electrodes are the same.
    """

    table: NDArray[np.int64]
    magnitudes: bool = False

    def __post_init__(self) -> None:
        given = np.asarray(self.table)
        table = given.astype(np.int64)
        if table.shape[1:] != (4,) or not len(table) or (table != given).any():
            raise InputError(
                "A drive pattern is an (M, 4) table src, sink, a, b of whole numbers; got "
                f"{given.shape}."
            )
        if (table[:, 0] == table[:, 1]).any() or (table[:, 2] == table[:, 3]).any():
            raise InputError(
                "A row of a drive pattern drives (src, sink) or measures (a, b) between an "
                "electrode and itself: these have to differ."
            )
        table.setflags(write=False)
        object.__setattr__(self, "table", table)

    @property
    def n_measurements(self) -> int:
        """M, the number of values in a frame."""
        return len(self.table)

    def reciprocal_pairs(self) -> NDArray[np.int64]:
        """Index pairs (k, 2) of measurements equal, up to sign, by reciprocity.

        Driving (src, sink) and measuring (a, b) equals driving (a, b) and measuring (src, sink).
        """
        seen: dict[tuple[frozenset[int], frozenset[int]], list[int]] = defaultdict(list)
        pairs = []
        for k, (src, sink, a, b) in enumerate(self.table.tolist()):
            drive, sense = frozenset((src, sink)), frozenset((a, b))
            pairs += [(earlier, k) for earlier in seen[sense, drive]]
            seen[drive, sense].append(k)
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)

    def reciprocal_signs(self, pairs: NDArray[np.int64]) -> NDArray[np.float64]:
        """s (k,) with v[pairs[:, 1]] = s v[pairs[:, 0]]: -1 where one of the pairs is reversed."""
        first, second = self.table[pairs[:, 0]], self.table[pairs[:, 1]]
        same = (first[:, 0] == second[:, 2]) == (first[:, 2] == second[:, 0])
        return np.where(same | self.magnitudes, 1.0, -1.0)

    @property
    def title(self) -> str:
        """What the pattern is, for people: its offset, or the offsets of its pairs."""
        e = int(self.table.max()) + 1
        for offset, driven in product(range(1, e), (False, True)):
            with suppress(InputError):  # too few electrodes to leave out the driven ones
                if np.array_equal(offset_pattern(e, offset, driven=driven).table, self.table):
                    return f"offset {offset}{', driven too' if driven else ''}"
        drives, senses = (
            {min((b - a) % e, (a - b) % e) for a, b in self.table[:, pair].tolist()}
            for pair in ((0, 1), (2, 3))
        )

        def said(offsets: set[int]) -> str:
            return ", ".join(map(str, sorted(offsets))) if len(offsets) < 4 else "several"

        return f"drive {said(drives)}, sense {said(senses)} apart"

    def describe(self) -> dict[str, object]:
        """Return all that defines the pattern as plain values, for hashing and printing."""
        return {"table": self.table.tolist(), "magnitudes": self.magnitudes}


def ring_pattern(
    n_electrodes: int,
    drive: int,
    sense: int,
    *,
    rotating: bool = False,
    driven: bool = False,
    magnitudes: bool = False,
) -> DrivePattern:
    """Drive (i, i+drive), measure (j, j+sense), drive-major.

    A negative offset -k reverses its pairs: (i+k, i). i ascends from 0, and j from 0, or from i if
    `rotating` (EIDORS: `rotate_meas`). Pairs that share an electrode with the drive pair are
    skipped unless `driven`.

    Raises:
        InputError: an offset whose size is not between 1 and n_electrodes - 1, or nothing is left
            to measure.
    """
    for offset in (drive, sense):
        whole = isinstance(offset, int | np.integer) and not isinstance(offset, bool)
        if not (whole and 1 <= abs(offset) < n_electrodes):
            raise InputError(
                f"An offset is a whole number from 1 to {n_electrodes - 1}, or its negative for "
                f"reversed pairs, got {offset}."
            )
    senses = _ring(n_electrodes, sense)
    rows = [
        row
        for i, pair in enumerate(_ring(n_electrodes, drive))
        for row in _rows(pair, senses[i * rotating :] + senses[: i * rotating], driven)
    ]
    if not rows:
        raise InputError(
            f"Of {n_electrodes} electrodes nothing is left to measure beside the drive pairs (i, "
            f"i{drive:+d}): use more electrodes, or measure driven ones, too (driven = true)."
        )
    return DrivePattern(np.array(rows, dtype=np.int64).reshape(-1, 4), magnitudes)


def offset_pattern(n_electrodes: int, offset: int, *, driven: bool = False) -> DrivePattern:
    """Drive (i, i+offset), measure (j, j+offset), as `ring_pattern` does.

    For 16 electrodes `offset=3` and `offset=4` both give 208 values, of which 104 and 62 are
    independent.
    """
    return ring_pattern(n_electrodes, offset, offset, driven=driven)


def opposition_pattern(n_electrodes: int) -> DrivePattern:
    """Drive (i, i + E/2), measure (j + 1, j) for j ascending, magnitudes only."""
    return ring_pattern(n_electrodes, n_electrodes // 2, -1, magnitudes=True)


def _ring(n_electrodes: int, offset: int) -> list[Pair]:
    """Pairs of each electrode with the one `offset` further; reversed where it is negative."""
    pairs = [(i, (i + abs(offset)) % n_electrodes) for i in range(n_electrodes)]
    return pairs if offset > 0 else [(b, a) for a, b in pairs]


def pair_pattern(
    drives: Iterable[Pair], senses: Iterable[Pair], *, driven: bool = False
) -> DrivePattern:
    """Every drive with every sense pair, drive-major; sharing an electrode needs `driven`."""
    senses = list(senses)
    rows = [row for drive in drives for row in _rows(drive, senses, driven)]
    return DrivePattern(np.array(rows, dtype=np.int64).reshape(-1, 4))


def _rows(drive: Pair, senses: list[Pair], driven: bool) -> list[tuple[int, ...]]:
    return [(*drive, *sense) for sense in senses if driven or not set(drive) & set(sense)]


def independent(
    pattern: DrivePattern,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Find the measurements that reciprocity leaves independent, and the map from them to all.

    Returns `first` (K,), the independent measurements' numbers, and `owner` and `sign` (M,), such
    that `v = v[first][owner] * sign`.
    """
    root, sign = np.arange(pattern.n_measurements), np.ones(pattern.n_measurements, np.float32)
    pairs = pattern.reciprocal_pairs()
    for (one, other), pair_sign in zip(pairs, pattern.reciprocal_signs(pairs), strict=True):
        # All that equal the one of the two with the later root equal the other one's root.
        first, last = (one, other) if root[one] < root[other] else (other, one)
        joined = root == root[last]
        sign[joined] *= sign[first] * pair_sign * sign[last]
        root[joined] = root[first]
    first, owner = np.unique(root, return_inverse=True)
    return first, owner, sign


def averaging(pattern: DrivePattern) -> NDArray[np.float64]:
    """(M, K): frames @ averaging are the independent values (K,), each the mean of its repetitions.

    The mean of two measurements has half of the variance of their noise.
    """
    first, owner, sign = independent(pattern)
    matrix = np.zeros((pattern.n_measurements, len(first)))
    matrix[np.arange(pattern.n_measurements), owner] = sign
    return np.asarray(matrix / np.bincount(owner))


Drives = list[Pair]


def equal_noise(pattern: DrivePattern) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(M, K): independent combinations of a frame that each have the noise of one measurement.

    A mean of two has less noise, so that the columns of `averaging` are divided by their norms,
    which are returned, too: (K,).
    """
    mean = averaging(pattern)
    norms = np.linalg.norm(mean, axis=0)
    return mean / norms, norms


def in_phase_differences(
    potentials: NDArray[np.complex128], drives: Drives, pattern: DrivePattern
) -> NDArray[np.float64]:
    """Re(U[a] - U[b]) as (..., M) from potentials U (..., drives, electrodes).

    The in-phase part carries the resistive field; a model with real conductivity has no other.
    """
    drive, a, b = places(drives, pattern)
    return np.real(potentials[..., drive, a] - potentials[..., drive, b])


def places(drives: Drives, pattern: DrivePattern) -> tuple[Index, Index, Index]:
    """Indices of the values of a frame in an array (drives, electrodes): drives, a and b."""
    row = {drive: k for k, drive in enumerate(drives)}
    src, sink, a, b = pattern.table.T
    drive = [row[pair] for pair in zip(src.tolist(), sink.tolist(), strict=True)]
    return np.array(drive), a, b
