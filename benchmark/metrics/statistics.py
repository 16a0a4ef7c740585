"""Bootstrap over clusters of samples, vectorised: every figure is computed in each draw at once.

A draw takes clusters (the frames of one session, say) with replacement, and is held as how often
each sample occurs in it: `counts` (b, n) for b draws of n samples. A statistic maps such counts
to its values, so that all figures of all methods share their draws and differences are paired.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.errors import InputError

LEVEL = 0.95
EQUAL = 1e-9
"""Sums of equal numbers may differ by less."""

MIN_CLUSTERS = 10
"""Fewer say too little of how much they differ among themselves."""
DRAWS = 2000
_BLOCK_BYTES = 2**24


class Interval(NamedTuple):
    """A figure with the ends of its interval."""

    value: float
    low: float
    high: float


def draw(statistic: Callable[[Array], Array], clusters: ArrayLike, *, draws: int = DRAWS) -> Array:
    """Compute `statistic` in `draws` bootstrap draws of whole clusters: (draws, ...).

    It maps counts (b, n) to values (b, ...), see `means`, `medians`, `spearman`. Samples with the
    same label in `clusters` (n,) are drawn together; the same clusters give the same draws.

    Source: Davison and Hinkley, Bootstrap Methods and their Application (1997), sec. 3.8.
    """
    _, of = np.unique(np.asarray(clusters), return_inverse=True)
    block = max(1, _BLOCK_BYTES // (8 * len(of)))
    if block >= draws:
        return statistic(_few_counts(of.astype(np.int64).tobytes(), draws))
    return np.concatenate([statistic(counts) for counts in _counts(of, draws, block)])


def _counts(of: NDArray[np.int64], draws: int, block: int) -> Iterator[Array]:
    """Counts (b, n) of samples whose clusters have the numbers `of` (n,), b `block` or fewer."""
    n, rng = int(of.max()) + 1, np.random.default_rng(0)
    for start in range(0, draws, block):
        size = min(block, draws - start)
        taken = rng.integers(n, size=(size, n)) + n * np.arange(size)[:, None]
        counts = np.bincount(taken.ravel(), minlength=size * n).reshape(size, n)
        yield counts[:, of].astype(np.float64)


@lru_cache(maxsize=4)  # all figures and methods of a board have the same clusters
def _few_counts(of: bytes, draws: int) -> Array:
    """All counts (draws, n) of samples whose clusters have numbers of these bytes."""
    (counts,) = _counts(np.frombuffer(of, np.int64), draws, draws)
    counts.setflags(write=False)
    return counts


def once(statistic: Callable[[Array], Array], n: int) -> Array:
    """Compute `statistic` of the `n` samples as they are, each once."""
    value: Array = statistic(np.ones((1, n)))[0]
    return value


def means(counts: Array, values: Array) -> Array:
    """Means (b, k) of the columns of `values` (n, k) over what is not NaN; NaN where all is."""
    known = ~np.isnan(values)
    total = counts @ np.where(known, values, 0.0)
    size = counts.sum(axis=1, keepdims=True) if known.all() else counts @ known.astype(np.float64)
    return np.divide(total, size, out=np.full_like(total, np.nan), where=size > 0)


def medians(counts: Array, values: Array) -> Array:
    """Medians (b, k) of the columns of `values` (n, k) over what is not NaN; NaN where all is."""
    found = np.full((len(counts), values.shape[1]), np.nan)
    for column, out in zip(values.T, found.T, strict=True):
        order = np.argsort(column)[: np.count_nonzero(~np.isnan(column))]
        if not len(order):
            continue
        size = counts[:, order].sum(axis=1)
        # The middle one, or the mean of the middle two, of the values repeated as often as drawn.
        middle = np.stack([(size + 1) // 2, size // 2 + 1], axis=1)
        low, high = column[order[_reaching(counts, order, middle)]].T
        out[:] = np.where(size > 0, (low + high) / 2, np.nan)
    return found


def quantile(counts: Array, values: Array, share: float) -> Array:
    """The least of `values` (n,) that at least `share` of each draw (b,) does not exceed.

    NaN of nothing.
    """
    if not len(values):
        return np.full(len(counts), np.nan)
    order, size = np.argsort(values), counts.sum(axis=1)
    (reached,) = _reaching(counts, order, share * size[:, None] - EQUAL).T
    return np.where(size > 0, values[order[reached]], np.nan)


@compiled
def _reaching(counts: Array, order: NDArray[np.int64], levels: Array) -> NDArray[np.int64]:
    """Places (b, k) in `order` (n,) at which the sum of the counts (b, n) reaches each level.

    Those of the `levels` (b, k) of a draw ascend. A level that is not reached has the last place.
    """
    places = np.empty(levels.shape, np.int64)
    for draw in range(len(counts)):
        total, after = 0.0, 0
        for k in range(levels.shape[1]):
            while total < levels[draw, k] and after < len(order):
                total += counts[draw, order[after]]
                after += 1
            places[draw, k] = max(after - 1, 0)
    return places


def spearman(counts: Array, x: Array, y: Array) -> Array:
    """Rank correlations (b,) of `x` with the known `y` (n,), ties sharing their mean rank.

    0 where `x` is constant (it tells nothing of `y`); NaN where `y` is.
    """
    size = counts.sum(axis=1, keepdims=True)
    a, b = (ranks(counts, values) - (size + 1) / 2 for values in (x, y))
    spread_a, spread_b = ((counts * rank * rank).sum(axis=1) for rank in (a, b))
    norm = np.sqrt(spread_a * spread_b)
    covariance = (counts * a * b).sum(axis=1)
    found = np.divide(covariance, norm, out=np.zeros_like(norm), where=norm > 0)
    return np.where(spread_b > 0, found, np.nan)


def ranks(counts: Array, values: Array) -> Array:
    """Mean ranks (b, n) of the samples in each draw, equals sharing theirs."""
    order = np.argsort(values)
    _, first, of = np.unique(values, return_index=True, return_inverse=True)
    starts = np.searchsorted(values[order], values[first])
    groups = np.add.reduceat(counts[:, order], starts, axis=1)
    ranks: Array = (np.cumsum(groups, axis=1) - (groups - 1) / 2)[:, of]
    return ranks


def intervals(value: Array, drawn: Array, clusters: int) -> Array:
    """Ends (2, ...) of the interval of each `value` (...) from its `drawn` values (draws, ...).

    The percentile interval, widened for few clusters as Student's interval is; NaN where a draw
    has no value, and for a single cluster, which says nothing about others.

    Source: Hesterberg, What Teachers Should Know About the Bootstrap, The American Statistician
    69(4), 2015, sec. 3.2.2 (expanded percentile interval).
    """
    if clusters < 2:
        return np.full((2, *np.shape(value)), np.nan)
    quantile = special.stdtrit(clusters - 1, (1 - LEVEL) / 2) * np.sqrt(clusters / (clusters - 1))
    low = float(special.ndtr(quantile))
    ends: Array = np.quantile(drawn, [low, 1 - low], axis=0)
    return np.where(np.isnan(value), np.nan, ends)


def bootstrap(
    values: ArrayLike,
    clusters: ArrayLike,
    statistic: Callable[[Array, Array], Array] = means,
) -> list[Interval]:
    """Return the `statistic` of each column of `values` (n, k), with its interval over `clusters`.

    Rows with the same label in `clusters` (n,) are drawn together, see `draw`. All columns share
    their draws. Paired differences as `values` give the interval of a difference between two
    methods on the same samples.

    Raises:
        InputError: fewer than 2 samples, or values that are not finite.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise InputError(
            f"A bootstrap needs finite values of at least 2 samples, got shape {table.shape}."
        )
    whole = once(lambda counts: statistic(counts, table), len(table))
    drawn = draw(lambda counts: statistic(counts, table), clusters)
    return _rows(whole, intervals(whole, drawn, len(np.unique(np.asarray(clusters)))))


def _rows(values: Array, ends: Array) -> list[Interval]:
    return [Interval(*map(float, three)) for three in zip(values, *ends, strict=True)]


def seed_means(values: ArrayLike) -> list[Interval]:
    """Return the mean of each column of `values` (g, n, k), with its 95 % interval over groups.

    Groups are trainings with different seeds, scored on the same n samples: the interval is
    Student's over the g means, and is for further trainings on these samples. A bootstrap of three
    seeds is too short.

    Raises:
        InputError: fewer than 2 groups, or values that are not finite.
    """
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 3 or len(table) < 2 or not table.size or not np.isfinite(table).all():
        raise InputError(
            f"An interval over seeds needs finite values of at least 2 trainings, got shape "
            f"{table.shape}."
        )
    means = table.mean(axis=1)
    value, groups = means.mean(axis=0), len(means)
    quantile = -special.stdtrit(groups - 1, (1 - LEVEL) / 2)
    half = quantile * means.std(axis=0, ddof=1) / np.sqrt(groups)
    return _rows(value, np.stack([value - half, value + half]))


def student_t(value: ArrayLike, drawn: Array, clusters: int) -> Array:
    """Student's t (...) of each `value` (...) by the spread of its `drawn` values (draws, ...).

    It is 0 where the spread is not known, as some draws have no value.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), ch. 12.
    """
    error = drawn.std(axis=0) * np.sqrt(clusters / (clusters - 1))
    nothing = np.isnan(error) | (np.abs(value) < EQUAL)
    sure = np.where(nothing, 0.0, np.copysign(np.inf, value))
    return np.asarray(np.divide(value, error, out=sure, where=error >= EQUAL))


def signed_rank(differences: Array, clusters: ArrayLike) -> float:
    """P-value of Wilcoxon's signed-rank test that paired `differences` (n,) exceed 0.

    The null hypothesis is that they are symmetric about 0; NaN is left out. Differences of one
    cluster count as their mean; those of 0 are ranked, and their ranks then dropped (Pratt). It is
    1 where all are 0. The test finds more than the bootstrap of a difference of medians does.

    Source: Wilcoxon, Individual Comparisons by Ranking Methods, Biometrics Bulletin 1(6), 1945;
    zeros as Pratt, Journal of the American Statistical Association 54, 1959.
    """
    known = ~np.isnan(differences)
    _, of = np.unique(np.asarray(clusters)[known], return_inverse=True)
    means = np.bincount(of, differences[known]) / np.bincount(of)
    means = np.round(means / EQUAL) * EQUAL  # those that rounding alone tells apart are tied
    if not means.any():
        return 1.0
    return float(stats.wilcoxon(means, zero_method="pratt", alternative="greater").pvalue)


def signed_rank_of(difference: float, differences: Array, clusters: ArrayLike) -> float:
    """Two-sided p-value of `signed_rank`, in the direction of the `difference` of two medians.

    `differences` (n,) are paired, and belong to `clusters` (n,). A difference of medians and most
    ranks may differ in sign: such a pair shows no difference.
    """
    return min(1.0, 2 * signed_rank(np.sign(difference) * differences, clusters))


def holm(p: ArrayLike) -> Array:
    """P-values (k,) adjusted so that the chance of any false finding among all stays bounded.

    Source: Holm, A Simple Sequentially Rejective Multiple Test Procedure, Scandinavian Journal of
    Statistics 6(2), 1979.
    """
    values = np.asarray(p, dtype=np.float64)
    order = np.argsort(values)
    steps = values[order] * np.arange(len(values), 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted
