"""Errors of the places of single presses over the skin, in any bootstrap draw of the presses.

`counts` (b, n) say how often each of the n presses of a cell occurs in each of b draws, as in
`eitbench.benchmark.metrics.aggregation`. Cells that know no places, or of touches with several
contacts, have none of these figures.
"""

from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial import KDTree

from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.metric_spec import CellStatistic
from eitbench.benchmark.metrics.statistics import means, quantile
from eitbench.scenarios.arrays import Array

NEIGHBOURS = 25
"""Presses whose median error is the local error: that of the place of the press amid them."""
LEAST_PRESSES = 4 * NEIGHBOURS
"""With fewer, neighbours lie all over the skin."""


def p90_mm(cell: pd.DataFrame, counts: Array) -> Array:
    """The error that 90 % of the presses stay within (b,) [mm]."""
    known, error, _ = _presses(cell)
    return quantile(counts[:, known], error, 0.9)


def within(distance_mm: float) -> CellStatistic:
    """The statistic of the share (b,) of presses that are found within `distance_mm`."""

    def share(cell: pd.DataFrame, counts: Array) -> Array:
        known, error, _ = _presses(cell)
        near: Array = means(counts[:, known], (error <= distance_mm).astype(np.float64)[:, None])
        return near[:, 0]

    return share


def unevenness(cell: pd.DataFrame, counts: Array) -> Array:
    """Coefficient of variation of the local error over the skin (b,)."""
    known, error, places = _presses(cell)
    if len(error) < LEAST_PRESSES:
        return np.full(len(counts), np.nan)
    local = local_errors(error, places)
    mean, square = means(counts[:, known], np.stack([local, local**2], axis=1)).T
    spread = np.sqrt(np.maximum(square - mean**2, 0.0))
    return np.asarray(np.divide(spread, mean, out=np.full_like(mean, np.nan), where=mean > 0))


def worst_tenth_mm(cell: pd.DataFrame, counts: Array) -> Array:
    """The local error that the worst tenth of the places reaches (b,) [mm]."""
    known, error, places = _presses(cell)
    if len(error) < LEAST_PRESSES:
        return np.full(len(counts), np.nan)
    return quantile(counts[:, known], local_errors(error, places), 0.9)


def local_errors(error: Array, places: Array) -> Array:
    """Median error (n,) of the `NEIGHBOURS` presses that are nearest to each of n `places` (n, 2).

    Neighbours are the same in every turned, mirrored or scaled picture of the skin.
    """
    return np.asarray(np.median(error[_nearest(places.tobytes())], axis=1))


@lru_cache(maxsize=8)  # all methods of a board have the same places
def _nearest(places: bytes) -> NDArray[np.int64]:
    """The `NEIGHBOURS` nearest (n, k) of each of n places, which are given as their bytes."""
    xy = np.frombuffer(places).reshape(-1, 2)
    _, nearest = KDTree(xy).query(xy, min(NEIGHBOURS, len(xy)))
    return np.asarray(nearest).reshape(len(xy), -1)


def _presses(cell: pd.DataFrame) -> tuple[NDArray[np.bool_], Array, Array]:
    """Rows (n,) of single presses with known places, their errors (n,) [mm] and places (n, 2)."""
    names = ["localisation_mm", "expected_x_m", "expected_y_m"]
    values = np.full((len(cell), 3), np.nan)
    # Tables of images hold these columns, too, with nothing in the last ones.
    if all(name in cell for name in names) and not np.isnan(numbers(cell, names[-1])).all():
        values = np.stack([numbers(cell, name) for name in names], axis=1)
    known = ~np.isnan(values).any(axis=1)
    if known.any() and "farthest_contact_mm" in cell and cell["farthest_contact_mm"].notna().any():
        known[:] = False  # several contacts
    return known, values[known, 0], values[known, 1:]
