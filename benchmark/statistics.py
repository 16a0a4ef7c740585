"""Intervals of means and medians over samples."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.errors import InputError

Array = NDArray[np.float64]

LEVEL = 0.95
RESAMPLES = 2000


class Interval(NamedTuple):
    """A mean, or a median, with the ends of its interval."""

    value: float
    low: float
    high: float


def bootstrap_means(values: ArrayLike, seed: int = 0) -> list[Interval]:
    """The mean of each column of `values` (n, k), with its 95 % percentile bootstrap interval.

    All columns share their resamples. Paired differences as `values` give the interval of a
    difference between two methods on the same samples.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), ch. 13.

    Raises:
        InputError: fewer than 2 samples, or values that are not finite.
    """
    return _bootstrap(values, np.mean, seed)


def bootstrap_medians(values: ArrayLike, seed: int = 0) -> list[Interval]:
    """As `bootstrap_means`, for medians.

    Raises:
        InputError: as for `bootstrap_means`.
    """
    return _bootstrap(values, np.median, seed)


def _bootstrap(values: ArrayLike, statistic: Callable[..., Array], seed: int) -> list[Interval]:
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise InputError(
            f"A bootstrap needs finite values of at least 2 samples, got shape {table.shape}."
        )
    rng, n = np.random.default_rng(seed), len(table)
    drawn = [statistic(table[rng.integers(n, size=n)], axis=0) for _ in range(RESAMPLES)]
    return _intervals(statistic(table, axis=0), np.array(drawn))


def _intervals(values: Array, drawn: Array) -> list[Interval]:
    ends = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    return [Interval(*map(float, three)) for three in zip(values, *ends, strict=True)]


def nested_bootstrap_means(values: ArrayLike, seed: int = 0) -> list[Interval]:
    """The mean of each column of `values` (g, n, k), with its 95 % interval over both.

    Groups (trainings with different seeds) are resampled first, samples within all of them alike.

    Source: Davison and Hinkley, Bootstrap Methods and their Application (1997), sec. 3.8.

    Raises:
        InputError: fewer than 2 groups or samples, or values that are not finite.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 3 or min(table.shape[:2]) < 2 or not np.isfinite(table).all():
        raise InputError(
            "A nested bootstrap needs finite values of at least 2 groups of 2 samples, got shape "
            f"{table.shape}."
        )
    rng = np.random.default_rng(seed)
    groups, n, _ = table.shape
    means = np.array(
        [
            table[rng.integers(groups, size=groups)][:, rng.integers(n, size=n)].mean(axis=(0, 1))
            for _ in range(RESAMPLES)
        ]
    )
    return _intervals(table.mean(axis=(0, 1)), means)
