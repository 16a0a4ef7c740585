"""Bootstrap intervals, beside SciPy's and beside normal theory."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from eitbench.benchmark.metrics.statistics import (
    bootstrap,
    draw,
    holm,
    intervals,
    means,
    medians,
    once,
    seed_means,
    signed_rank,
    signed_rank_of,
    spearman,
    student_t,
)
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError


def test_intervals_are_those_of_scipy() -> None:
    values = np.random.default_rng(1).exponential(size=(60, 2)) * [1, 10]
    for column, interval in zip(values.T, bootstrap(values, range(60)), strict=True):
        other = stats.bootstrap(
            (column,), np.mean, n_resamples=20000, method="percentile", rng=2
        ).confidence_interval
        assert interval.value == pytest.approx(column.mean())
        width = other.high - other.low
        assert interval.low == pytest.approx(other.low, abs=0.05 * width)
        assert interval.high == pytest.approx(other.high, abs=0.05 * width)


@pytest.mark.parametrize(("n", "skew"), [(12, False), (50, False), (50, True)])
def test_about_95_of_100_intervals_hold_the_truth(n: int, skew: bool) -> None:
    rng = np.random.default_rng(5)
    values = rng.exponential(1, size=(n, 1000)) - 1 if skew else rng.normal(size=(n, 1000))
    held = sum(interval.low <= 0 <= interval.high for interval in bootstrap(values, range(n)))
    assert 0.92 <= held / 1000 <= 0.97


def chance(trials: int, share: float) -> tuple[float, float]:
    """How many of `trials` a share is: the bounds are left once in a thousand runs."""
    low, high = (stats.binom.ppf(q, trials, share) for q in (5e-4, 1 - 5e-4))
    return float(low), float(high)


SESSIONS, TOUCHES = 40, 3


def with_sessions(effect: float, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """Values (samples, ...) of deviation 1 whose sessions share so much: a reference's noise."""
    shared = rng.normal(0, effect, size=(SESSIONS, 1, *shape))
    alone = rng.normal(0, np.sqrt(1 - effect**2), size=(SESSIONS, TOUCHES, *shape))
    return (shared + alone).reshape(-1, *shape)


OF_SESSION = np.repeat(np.arange(SESSIONS), TOUCHES)


@pytest.mark.parametrize("effect", [0.0, 0.5, 0.9])
def test_intervals_over_sessions_cover_what_they_promise(effect: float) -> None:
    """What sessions share, such as the noise of a reference frame, is in the interval."""
    trials = 2000
    values = with_sessions(effect, (trials,), np.random.default_rng(6))
    missed = sum(not i.low <= 0 <= i.high for i in bootstrap(values, OF_SESSION))
    low, high = chance(trials, 0.05)
    assert low <= missed <= high
    if effect == 0.9:
        alone = sum(not i.low <= 0 <= i.high for i in bootstrap(values, range(len(values))))
        assert alone > 3 * high  # as if no session shared anything


def test_medians_of_draws_are_those_of_repeated_values() -> None:
    rng = np.random.default_rng(7)
    values = rng.normal(size=(9, 3))
    values[2, 0] = values[5, 0] = np.nan
    values[:, 2] = np.nan
    counts = rng.integers(3, size=(20, 9)).astype(float)
    found = medians(counts, values)
    for row, out in zip(counts.astype(int), found, strict=True):
        repeated = np.repeat(values, row, axis=0)
        assert out[0] == pytest.approx(np.nanmedian(repeated[:, 0]))
        assert out[1] == pytest.approx(np.median(repeated[:, 1]))
    assert np.isnan(found[:, 2]).all()


def test_rank_correlations_of_draws_are_those_of_repeated_values() -> None:
    """Beside SciPy's, with ties, of values that are repeated as often as they are drawn."""
    rng = np.random.default_rng(8)
    y = rng.integers(4, size=12).astype(float)
    x = y + rng.normal(size=12).round(1)
    counts = rng.integers(1, 4, size=(20, 12)).astype(float)
    found = spearman(counts, x, y)
    for row, value in zip(counts.astype(int), found, strict=True):
        other = stats.spearmanr(np.repeat(x, row), np.repeat(y, row)).statistic
        assert value == pytest.approx(other, abs=1e-12)
    assert spearman(counts, np.ones(12), y).tolist() == [0] * 20  # it tells nothing
    assert np.isnan(spearman(counts, x, np.ones(12))).all()


def test_draws_take_whole_clusters_as_often_as_there_are() -> None:
    clusters = np.array(["b", "a", "b", "c", "c", "c"])
    counts = draw(lambda counts: counts, clusters, draws=500)
    assert counts.shape == (500, 6)
    np.testing.assert_array_equal(counts[:, 0], counts[:, 2])
    np.testing.assert_array_equal(counts[:, 3], counts[:, 5])
    np.testing.assert_array_equal(counts[:, [0, 1, 3]].sum(axis=1), 3)
    np.testing.assert_allclose(counts.mean(axis=0), 1, atol=0.15)
    np.testing.assert_array_equal(draw(lambda c: c, clusters, draws=500), counts)
    assert once(lambda c: means(c, np.arange(6.0)[:, None]), 6) == pytest.approx(2.5)


def test_holm_as_worked_by_hand() -> None:
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm([0.5, 0.9]), [1.0, 1.0])


def test_columns_share_resamples_and_seeds_repeat() -> None:
    one = np.random.default_rng(4).normal(size=30)
    first, shifted = bootstrap(np.stack([one, 3 - 2 * one], axis=1), range(30))
    assert shifted.low == pytest.approx(3 - 2 * first.high)
    assert shifted.high == pytest.approx(3 - 2 * first.low)
    assert bootstrap(one[:, None], range(30))[0] == pytest.approx(first)


def test_equal_values_have_no_spread() -> None:
    (interval,) = bootstrap(np.full((5, 1), 0.25), range(5))
    assert interval == (0.25, 0.25, 0.25)


def test_one_cluster_has_a_value_and_no_interval() -> None:
    (interval,) = bootstrap(np.array([[1.0], [2.0]]), [0, 0])
    np.testing.assert_equal(interval, (1.5, np.nan, np.nan))


@pytest.mark.parametrize(
    ("intervals_of", "shape"),
    [
        *((lambda v: bootstrap(v, range(len(v))), shape) for shape in [(1, 4), (5,)]),
        *((seed_means, shape) for shape in [(1, 5, 2), (3, 0, 2), (3, 5)]),
    ],
)
def test_too_little_is_refused(
    intervals_of: Callable[[Array], object], shape: tuple[int, ...]
) -> None:
    for values in (np.zeros(shape), np.full((5, 5, 5)[: len(shape)], np.nan)):
        with pytest.raises(InputError, match="finite values of at least 2"):
            intervals_of(values)


@pytest.mark.parametrize("seeds", [2, 3, 5])
def test_intervals_over_few_seeds_cover_what_they_promise(seeds: int) -> None:
    """Seeds and single samples vary; of 2,000 intervals the binomial bounds how many may miss."""
    rng = np.random.default_rng(seeds)
    trials = 2000
    effects = 0.3 + rng.normal(0, 0.1, (seeds, 1, trials))
    values = effects + rng.normal(0, 0.5, (seeds, 40, trials))
    found = np.array(seed_means(values))
    missed = int(((found[:, 1] > 0.3) | (found[:, 2] < 0.3)).sum())
    low, high = (stats.binom.ppf(q, trials, 0.05) for q in (5e-4, 1 - 5e-4))
    assert low <= missed <= high
    assert found[:, 0] == pytest.approx(values.mean(axis=(0, 1)))


def _presses(better: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Errors (60,) [mm] of two methods: hard presses are hard for both, and errors are skewed."""
    shared = 10 * np.exp(0.6 * rng.normal(size=60))
    one, other = (shared * np.exp(0.3 * rng.normal(size=60)) for _ in range(2))
    return one, better * other


def test_few_clusters_widen_intervals_as_student_does() -> None:
    """Of 5 clusters 2.776 sqrt(5/4) = 3.104 standard deviations, of 1,000 nearly 1.96."""
    drawn = stats.norm.ppf((np.arange(200_000) + 0.5) / 200_000)[:, None]
    for clusters, expected in ((5, 3.104), (1000, 1.9633)):
        ends = intervals(np.zeros(1), drawn, clusters)
        np.testing.assert_allclose(ends[:, 0], [-expected, expected], rtol=2e-3)
    two = np.array([[0.0], [2.0]])  # their deviation is 1
    np.testing.assert_allclose(student_t([1.0], two, 5), [1 / np.sqrt(1.25)])
    np.testing.assert_allclose(student_t([-1.0], two, 2), [-1 / np.sqrt(2)])


def test_a_spread_that_is_not_known_shows_no_difference() -> None:
    drawn = np.array([[1.0, 1.0, 2.0], [np.nan, 1.0, 4.0]])
    assert student_t([1.5, 1.5, 0.0], drawn, 10).tolist() == [0.0, np.inf, 0.0]


@pytest.mark.slow
def test_signed_ranks_find_as_few_differences_by_chance_as_promised() -> None:
    rng = np.random.default_rng(8)
    trials = 1000
    greater, either = 0, 0
    for _ in range(trials):
        one, other = _presses(1.0, rng)
        greater += int(signed_rank(one - other, np.arange(60)) < 0.05)
        rise = float(np.median(one) - np.median(other))
        either += int(signed_rank_of(rise, one - other, np.arange(60)) < 0.05)
    low, high = chance(trials, 0.05)
    assert low <= greater <= high
    assert either <= high


def test_signed_ranks_find_what_the_bootstrap_of_medians_misses() -> None:
    """An error that is 15 % smaller, with 60 presses."""
    rng = np.random.default_rng(9)
    found = {"ranks": 0, "bootstrap": 0}
    for _ in range(100):
        one, other = _presses(0.85, rng)
        both = np.stack([one, other], axis=1)
        drawn = draw(lambda counts: medians(counts, both), np.arange(60), draws=400)  # noqa: B023
        t = student_t(np.median(one) - np.median(other), drawn[:, 0] - drawn[:, 1], 60)
        found["bootstrap"] += int(2 * stats.t.sf(abs(t), 59) < 0.05)
        found["ranks"] += int(signed_rank_of(1.0, one - other, np.arange(60)) < 0.05)
    assert found["ranks"] > 65 > 50 > found["bootstrap"]


def test_means_of_clusters_that_rounding_alone_tells_apart_are_tied() -> None:
    differences = np.array([0.1, 0.2, 0.3, -0.3, -0.2, -0.1, 0.7, 0.5, 0.9, 0.25])
    clusters = np.array([0, 0, 0, 1, 1, 1, 2, 3, 4, 5])
    exact = np.array([20, -20, 70, 50, 90, 25])
    assert signed_rank(differences, clusters) == signed_rank(exact, np.arange(6))


def test_signed_ranks_take_a_cluster_once_and_leave_out_what_is_not_known() -> None:
    rng = np.random.default_rng(1)
    means, clusters = rng.normal(0.4, 1, 30), np.repeat(np.arange(30), 4)
    repeated = np.repeat(means, 4) + np.tile([0.2, -0.2, np.nan, 0.0], 30)
    expected = stats.wilcoxon(means, alternative="greater").pvalue
    assert signed_rank(repeated, clusters) == pytest.approx(expected)
    assert signed_rank(np.zeros(20), np.arange(20)) == 1.0


def test_equal_pairs_are_ranked_and_then_dropped() -> None:
    """As Pratt does it: 20 zeros take the ranks 1 to 20, so that 8 ones have 24.5 each."""
    differences = np.array([0.0] * 20 + [1.0] * 7 + [-1.0])
    ranks = 24.5 * np.sign(differences)
    deviation = np.sqrt(np.sum(ranks**2))
    expected = float(stats.norm.sf(ranks.sum() / deviation))
    assert signed_rank(differences, np.arange(28)) == pytest.approx(expected, rel=0.05)


def test_medians_that_differ_against_most_ranks_show_no_difference() -> None:
    """A rise of the median is no finding where the errors of most pairs fell."""
    rng = np.random.default_rng(3)
    fell = -np.abs(rng.normal(1, 0.2, 36))
    assert signed_rank_of(-1.0, fell, np.arange(36)) < 1e-6
    assert signed_rank_of(0.4, fell, np.arange(36)) == 1.0
