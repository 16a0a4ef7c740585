"""The search for the wiring that explains one frame: hypotheses, their misfits, and their order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.imperfections.faults import SILENT
from eitbench.scenarios.wiring.hypotheses import (
    Order,
    Table,
    Wiring,
    meaning,
    numberings,
    numbers_of,
    with_swaps,
)

EXPLAINED = 0.5
"""Misfit above which no wiring explains the frames."""
SWAP_GAIN = 1.25
"""Misfit without over that with two electrodes interchanged, below which none are."""
SMALL = 0.02
"""Size of a value over the upper quartile's, below which it says nothing of the order: an electrode
without contact has it."""
_FAR = 10.0
"""Size of a value over that of the largest tenth, above which an amplifier saturates."""
_TURNED = 40
"""Answers with interchanged electrodes, the best ones, that are tried from every electrode."""
_DISTINCT = 150
"""Answers, the best ones, of which those that mean the same are found; more of many electrodes, as
on a round sensor every answer has equals from each electrode, in both directions and orders."""
_WORK = 400_000
"""Values that are predicted for hypotheses with interchanged electrodes."""


def size_of(values: Array) -> float:
    """Upper quartile of sizes: one dead electrode of eight silences half of the values."""
    return float(np.quantile(np.abs(values), 0.75))


@dataclass(frozen=True)
class Found:
    """An answer: the wiring, its misfit, and the sign (1 or -1) that the frame has beside it."""

    wiring: Wiring
    misfit: float
    sign: int


class Search:
    """Hypotheses against one frame (M,)."""

    def __init__(
        self, frame: Array, candidates: list[Order], expected: Array, magnitudes: bool
    ) -> None:
        self._orders, self._expected, self._magnitudes = candidates, expected, magnitudes
        self._e = len(expected)
        self._tables = np.stack([order.table for order in candidates])
        self._frame = frame
        loud = np.abs(frame) >= SMALL * size_of(frame)
        unread = np.stack([mute_and_far(frame, table) for table in self._tables])
        self._mute = unread[:, 0]
        self._kept = loud & ~unread.any(axis=1)
        self._shown = _unit(np.broadcast_to(frame, self._kept.shape), magnitudes, self._kept)

    def table(self, wiring: Wiring) -> Table:
        """(M, 4) in the sensor's numbers."""
        return np.asarray(wiring.numbers(self._e)[self._orders[wiring.order].table])

    def misfit_of(self, table: Table) -> float:
        """Misfit of a table (M, 4) with its own sign."""
        kept = np.abs(self._frame) >= SMALL * size_of(self._frame)
        return self._misfit(self._expected[tuple(table.T)], kept)

    def explains_silence(self, of: Found) -> bool:
        """True if the electrode that was left out as silent is silent beside this answer, too."""
        mute, kept = self._mute[of.wiring.order], self._kept[of.wiring.order]
        expected = self._expected[tuple(self.table(of.wiring).T)]
        size, wanted = self._frame**2, expected**2
        silent = size[mute].sum() * wanted[kept].sum() < (
            SILENT**2 * wanted[mute].sum() * size[kept].sum()
        )
        return bool(silent or not mute.any() or self._misfit(expected, kept | mute) <= EXPLAINED)

    def _misfit(self, expected: Array, kept: NDArray[np.bool_]) -> float:
        cosine = _unit(expected, self._magnitudes, kept) @ _unit(
            self._frame, self._magnitudes, kept
        )
        return float(np.sqrt(max(1 - max(float(cosine), 0.0) ** 2, 0.0)))

    def scored(self, wirings: list[Wiring]) -> list[Found]:
        """The misfits of `wirings`, with the sign that fits."""
        found: list[Found] = []
        step = max(1, 2_000_000 // self._kept.shape[1])
        for first in range(0, len(wirings), step):
            part = wirings[first : first + step]
            numbers = numbers_of(part, self._e)
            of = np.array([wiring.order for wiring in part])
            tables = numbers[np.arange(len(part))[:, None, None], self._tables[of]]
            predicted = self._expected[tuple(np.moveaxis(tables, -1, 0))]
            predicted = _unit(predicted, self._magnitudes, self._kept[of])
            cosine = np.einsum("nm,nm->n", predicted, self._shown[of])
            # Of magnitudes that fall where the prediction rises, no sign makes an answer.
            size = np.maximum(cosine, 0) if self._magnitudes else np.abs(cosine)
            # Rounded: of answers that mean the same the first one is kept.
            misfit = np.round(np.sqrt(np.maximum(1 - size**2, 0)), 6)
            sign = np.where(self._magnitudes | (cosine >= 0), 1, -1)
            found += map(Found, part, misfit.tolist(), sign.tolist())
        return found

    def ranked(self) -> list[Found]:
        """The answers that differ, the best first; without interchanged electrodes if that fits."""
        plain = self._distinct(self.scored(list(numberings(self._orders, self._e))))
        pairs = self._e * (self._e - 1) // 2
        looked_at = max(3, _WORK // (pairs * self._kept.shape[1]))
        swapped: list[Found] = []
        for of in plain[:looked_at]:
            swapped += self.scored(list(with_swaps(of.wiring, self._e)))
        swapped.sort(key=lambda of: of.misfit)
        # The few that were looked at need not begin at the right electrode.
        kinds = dict.fromkeys((of.wiring.order, of.wiring.swapped) for of in swapped[:_TURNED])
        swapped = self.scored([
            Wiring(order, start, step, pair)
            for order, pair in kinds
            for step in (1, -1)
            for start in range(self._e)
        ])  # fmt: skip
        swapped.sort(key=lambda of: of.misfit)
        if not swapped or plain[0].misfit < SWAP_GAIN * swapped[0].misfit:
            return plain
        return self._distinct(sorted([*plain, *swapped[:_DISTINCT]], key=lambda of: of.misfit))

    def not_turned(self, best: Found, others: list[Found]) -> list[Found]:
        """Those of `others` whose frame is not that of `best` with other numbers around the rim."""
        around = [
            Wiring(0, start, step).numbers(self._e) for step in (1, -1) for start in range(self._e)
        ]
        turned = set(self._meant(np.stack([turn[self.table(best.wiring)] for turn in around])))
        if not others:
            return []
        meant = self._meant(np.stack([self.table(of.wiring) for of in others]))
        return [of for of, code in zip(others, meant, strict=True) if code not in turned]

    def _meant(self, tables: Table) -> list[bytes]:
        """What tables (n, M, 4) mean: equal for those that no linear sensor tells apart."""
        codes = meaning(tables, self._e, magnitudes=self._magnitudes)
        return [code.tobytes() for code in codes]

    def _distinct(self, found: list[Found]) -> list[Found]:
        found = sorted(found, key=lambda of: of.misfit)[: max(_DISTINCT, 8 * self._e)]
        seen: dict[bytes, Found] = {}
        tables = np.stack([self.table(of.wiring) for of in found])
        for of, code in zip(found, self._meant(tables), strict=True):
            seen.setdefault(code, of)
        return list(seen.values())


def mute_and_far(frame: Array, table: Table) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Values (M,) of the quietest electrode, if that is silent, and values too large to be real.

    Args:
        frame: (M,).
        table: (M, 4) an order, in the board's numbers. In a wrong one hardly any electrode has all
            the values that a dead one silences.
    """
    size = np.abs(frame)
    of = (table == np.unique(table)[:, None, None]).any(axis=2)
    loudness = np.array([size_of(size[rows]) for rows in of])
    quietest = int(np.argmin(loudness))
    mute = of[quietest] & bool(loudness[quietest] < SILENT * np.median(loudness))
    return mute, size > _FAR * np.quantile(size[~mute], 0.9)


def _unit(values: Array, magnitudes: bool, kept: NDArray[np.bool_]) -> Array:
    """Roots of values (..., M) of norm 1, of magnitudes without their mean; 0 if not `kept`."""
    roots = np.where(kept, np.sqrt(np.abs(values)), 0)
    if magnitudes:
        mean = roots.sum(axis=-1, keepdims=True) / np.maximum(kept.sum(axis=-1, keepdims=True), 1)
        roots = np.where(kept, roots - mean, 0)
    else:
        roots = np.sign(values) * roots
    size = np.linalg.norm(roots, axis=-1, keepdims=True)
    return np.asarray(roots / np.where(size > 0, size, 1))
