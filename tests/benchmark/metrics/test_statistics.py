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
    nested_bootstrap_means,
    once,
)
from eitbench.scenarios.errors import InputError


def test_intervals_are_those_of_scipy() -> None:
    values = np.random.default_rng(1).exponential(size=(60, 2)) * [1, 10]
    for column, interval in zip(values.T, bootstrap(values), strict=True):
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
    held = sum(interval.low <= 0 <= interval.high for interval in bootstrap(values))
    assert 0.92 <= held / 1000 <= 0.97


def test_intervals_of_clusters_hold_the_truth_where_those_of_samples_do_not() -> None:
    """Six frames of each phantom, which differ far less among themselves than phantoms do."""
    rng = np.random.default_rng(6)
    phantoms, frames, tries = 30, 6, 500
    values = rng.normal(size=(phantoms, 1, tries)) + 0.3 * rng.normal(
        size=(phantoms, frames, tries)
    )
    table = values.reshape(-1, tries)
    of = np.repeat(np.arange(phantoms), frames)
    held = {}
    for name, clusters in (("phantoms", of), ("samples", np.arange(len(of)))):
        drawn = draw(lambda counts: means(counts, table), clusters, draws=1000)
        low, high = intervals(table.mean(axis=0), drawn, len(np.unique(clusters)))
        held[name] = ((low <= 0) & (high >= 0)).mean()
    assert 0.92 <= held["phantoms"] <= 0.975
    assert held["samples"] < 0.7


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
    first, shifted = bootstrap(np.stack([one, 3 - 2 * one], axis=1))
    assert shifted.low == pytest.approx(3 - 2 * first.high)
    assert shifted.high == pytest.approx(3 - 2 * first.low)
    assert bootstrap(one[:, None])[0] == pytest.approx(first)


def test_equal_values_have_no_spread() -> None:
    (interval,) = bootstrap(np.full((5, 1), 0.25))
    assert interval == (0.25, 0.25, 0.25)


@pytest.mark.parametrize(
    ("intervals_of", "shape"),
    [
        *((bootstrap, shape) for shape in [(1, 4), (5,)]),
        *((nested_bootstrap_means, shape) for shape in [(1, 5, 2), (3, 1, 2), (3, 5)]),
    ],
)
def test_too_little_is_refused(
    intervals_of: Callable[[object], object], shape: tuple[int, ...]
) -> None:
    for values in (np.zeros(shape), np.full((5, 5, 5)[: len(shape)], np.nan)):
        with pytest.raises(InputError, match="finite values of at least 2"):
            intervals_of(values)


def test_the_nested_interval_knows_how_much_groups_differ() -> None:
    """Groups that differ by far more than samples: the interval of the mean of their means."""
    rng = np.random.default_rng(3)
    levels = np.array([0.0, 1.0, 2.0, 5.0])
    values = levels[:, None, None] + 1e-3 * rng.normal(size=(4, 50, 2))
    flat = bootstrap(values.reshape(-1, 2))[0]
    found = nested_bootstrap_means(values)[0]
    assert found.value == pytest.approx(2.0, abs=1e-3)
    means = [rng.choice(levels, 4).mean() for _ in range(20000)]
    low, high = np.quantile(means, [0.025, 0.975])
    assert found.low == pytest.approx(low, abs=0.15)
    assert found.high == pytest.approx(high, abs=0.15)
    assert found.high - found.low > 4 * (flat.high - flat.low)
