"""Methods over many scenarios: mean ranks, wins, and the difference of mean ranks that counts.

A rank on a scenario is that of its ranking figure; figures of different scenarios are never mixed.
Mean ranks depend on which methods are compared (Benavoli, Corani and Mangili, Should We Really Use
Post-Hoc Tests Based on Mean-Ranks?, Journal of Machine Learning Research 17(5), 2016): whether one
method beats another is told by their paired differences on each scenario, see `Pair`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import stats

from eitbench.benchmark.metrics.statistics import LEVEL, bootstrap, medians
from eitbench.scenarios.arrays import Array

MIN_SCENARIOS = 6
"""Of fewer, no interval of a median holds 95 %: all lie on one side of it once in 16 times."""
_DIGITS = 9  # that count in a figure


@dataclass(frozen=True)
class OverallRow:
    """A method over all scenarios.

    Attributes:
        rank, rank_low, rank_high: mean over the scenarios, 1 for the best, equals sharing theirs,
            and its 95 % interval.
        wins, wins_low, wins_high: share of the scenarios on which it is the best, equals sharing a
            win, and its 95 % interval. Methods with the same figure on every scenario, such as
            those with the same images, share their rank and wins, and count as one for the others.
        ratio, ratio_low, ratio_high: median over the scenarios of its error over that of a blind
            guess, and its 95 % interval; None where a scenario has no guess.
    """

    method: str
    rank: float
    rank_low: float | None
    rank_high: float | None
    wins: float
    wins_low: float | None
    wins_high: float | None
    ratio: float | None
    ratio_low: float | None
    ratio_high: float | None


@dataclass(frozen=True)
class Overall:
    """The methods that were run on all of the scenarios.

    Attributes:
        scenarios: their names.
        rows: by mean rank.
        critical_difference: of two mean ranks that differ significantly (Nemenyi), at 5 % for all
            pairs together.
        friedman_p: of no difference between all methods; None for two of them.
        left_out: methods that lack a scenario.
    """

    scenarios: list[str]
    rows: list[OverallRow]
    critical_difference: float
    friedman_p: float | None
    left_out: list[str]


def mid_ranks(figures: Array) -> Array:
    """Ranks (..., k) of figures (..., k), the largest first; equals share the mean of theirs."""
    return np.asarray(stats.rankdata(-np.round(figures, _DIGITS), axis=-1))


def overall(
    figures: Mapping[str, Mapping[str, float]], guesses: Mapping[str, float] = MappingProxyType({})
) -> Overall | None:
    """Rank methods over scenarios; None where fewer than two methods are on two or more.

    Intervals are of a bootstrap over scenarios, as if these had been drawn from all that there
    could be; fewer than `MIN_SCENARIOS` give none.

    Source: Demsar, Statistical Comparisons of Classifiers over Multiple Data Sets, Journal of
    Machine Learning Research 7, 2006, sec. 3.2.

    Args:
        figures: of each scenario, the ranking figure of each method; more is better.
        guesses: of scenarios whose figures are errors with a minus sign, that of a blind guess.
    """
    known = list(dict.fromkeys(name for of in figures.values() for name in of))
    names = [name for name in known if all(name in of for of in figures.values())]
    n, k = len(figures), len(names)
    if n < 2 or k < 2:
        return None
    table = np.array([[of[name] for name in names] for of in figures.values()])
    # Names of the same method would push the others down and share their own wins.
    distinct, of_distinct = np.unique(np.round(table, _DIGITS), axis=1, return_inverse=True)
    ranks = mid_ranks(distinct)
    first = ranks == ranks.min(axis=1, keepdims=True)
    wins = first / first.sum(axis=1, keepdims=True)
    k_distinct = ranks.shape[1]
    both = np.hstack([ranks[:, of_distinct], wins[:, of_distinct]])
    mean = both.mean(axis=0)
    ends: list[tuple[float | None, float | None]] = [(None, None)] * (2 * k)
    if n >= MIN_SCENARIOS:
        ends = [(of.low, of.high) for of in bootstrap(both, np.arange(n))]
    ratios: list[tuple[float | None, float | None, float | None]] = [(None, None, None)] * k
    if all(guesses.get(name) for name in figures):
        over_guess = -table / np.array([[guesses[name]] for name in figures])
        ratios = [
            (of.value, *((of.low, of.high) if n >= MIN_SCENARIOS else (None, None)))
            for of in bootstrap(over_guess, np.arange(n), medians)
        ]
    rows = [
        OverallRow(names[j], float(mean[j]), *ends[j], float(mean[k + j]), *ends[k + j], *ratios[j])
        for j in range(k)
    ]
    quantile = stats.studentized_range.ppf(LEVEL, max(k_distinct, 2), np.inf) / np.sqrt(2)
    varies = k_distinct > 2 and bool(np.ptp(ranks, axis=1).any())
    return Overall(
        scenarios=list(figures),
        rows=sorted(rows, key=lambda row: (row.rank, row.method)),
        critical_difference=float(quantile * np.sqrt(k_distinct * (k_distinct + 1) / (6 * n))),
        friedman_p=float(stats.friedmanchisquare(*ranks.T).pvalue) if varies else None,
        left_out=[name for name in known if name not in names],
    )


class DataFigures(NamedTuple):
    """The methods on one data set.

    Attributes:
        suite: its name.
        frames: hashes of its test frames.
        figures: the ranking figure of each method; more is better.
    """

    suite: str
    frames: frozenset[str]
    figures: Mapping[str, float]


@dataclass(frozen=True)
class WinsRow:
    """A method over all suites that it took part in.

    Attributes:
        share, low, high: of its comparisons with another method on a data set, those that it wins,
            and the 95 % interval; None for both ends where it took part in
            fewer than `MIN_SCENARIOS` suites.
        suites: number of those.
        data_sets: number of theirs on which it has a figure.
    """

    method: str
    share: float
    low: float | None
    high: float | None
    suites: int
    data_sets: int


def wins_over_suites(figures: Iterable[DataFigures]) -> list[WinsRow]:
    """Share of comparisons that each method wins, a suite counting as much as any other.

    Frames count once: a data set is left out if most of its frames are in others that count. Data
    sets with the most frames come first, of equals those with the most methods. Methods
    that only others have win and lose nothing there.

    On a data set one with the rank r (1 for the best) of k figures wins (k - r) / (k - 1) of its
    comparisons. Methods with the same figure, such as those with the same images, count as one.
    The mean over the data sets of a suite is its share there, the mean over suites its share.
    Intervals are of a bootstrap over suites, as if these had been drawn from all that there could
    be. Methods of unlike suites met unlike opponents.

    Returns:
        First the methods that took part in `MIN_SCENARIOS` suites, then the others, each by share.
    """
    shares: dict[str, dict[str, list[float]]] = {}
    counted: set[str] = set()
    for suite, frames, known in sorted(figures, key=lambda of: (-len(of.frames), -len(of.figures))):
        if 2 * len(counted & frames) > len(frames):
            continue
        counted |= frames
        figures_of = np.round(list(known.values()), _DIGITS)
        distinct, below = np.unique(figures_of, return_inverse=True)
        won = below / max(len(distinct) - 1, 1)
        for name, share in zip(known, won, strict=True) if len(distinct) > 1 else ():
            shares.setdefault(name, {}).setdefault(suite, []).append(float(share))
    rows = []
    for name, by_suite in shares.items():
        means = np.array([[np.mean(of)] for of in by_suite.values()])
        ends: tuple[float | None, float | None] = (None, None)
        if len(means) >= MIN_SCENARIOS:
            ((_, *both),) = bootstrap(means, np.arange(len(means)))
            ends = (both[0], both[1])
        n = sum(map(len, by_suite.values()))
        rows.append(WinsRow(name, float(means.mean()), *ends, len(means), n))
    return sorted(rows, key=lambda row: (row.low is None, -row.share, row.method))
