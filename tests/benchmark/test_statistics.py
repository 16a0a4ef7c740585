"""Bootstrap intervals, beside SciPy's and beside normal theory."""

import numpy as np
import pytest
from scipy import stats

from eitbench.benchmark.statistics import bootstrap_means, nested_bootstrap_means
from eitbench.scenarios.errors import InputError


def test_intervals_are_those_of_scipy() -> None:
    values = np.random.default_rng(1).exponential(size=(60, 2)) * [1, 10]
    for column, interval in zip(values.T, bootstrap_means(values), strict=True):
        other = stats.bootstrap(
            (column,), np.mean, n_resamples=20000, method="percentile", rng=2
        ).confidence_interval
        assert interval.value == pytest.approx(column.mean())
        width = other.high - other.low
        assert interval.low == pytest.approx(other.low, abs=0.05 * width)
        assert interval.high == pytest.approx(other.high, abs=0.05 * width)


def test_many_samples_give_the_normal_interval() -> None:
    values = np.random.default_rng(3).normal(5, 2, size=(4000, 1))
    (interval,) = bootstrap_means(values)
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert interval.high - interval.value == pytest.approx(half, rel=0.1)
    assert interval.value - interval.low == pytest.approx(half, rel=0.1)


def test_about_95_of_100_intervals_hold_the_truth() -> None:
    intervals = bootstrap_means(np.random.default_rng(5).normal(0, 1, size=(50, 1000)))
    held = sum(interval.low <= 0 <= interval.high for interval in intervals)
    assert 0.91 <= held / 1000 <= 0.97


def test_columns_share_resamples_and_seeds_repeat() -> None:
    one = np.random.default_rng(4).normal(size=30)
    first, shifted = bootstrap_means(np.stack([one, 3 - 2 * one], axis=1))
    assert shifted.low == pytest.approx(3 - 2 * first.high)
    assert shifted.high == pytest.approx(3 - 2 * first.low)
    assert bootstrap_means(one[:, None])[0] == pytest.approx(first)
    assert bootstrap_means(one[:, None], seed=1)[0] != pytest.approx(first)


def test_equal_values_have_no_spread() -> None:
    (interval,) = bootstrap_means(np.full((5, 1), 0.25))
    assert interval == (0.25, 0.25, 0.25)


@pytest.mark.parametrize("values", [np.zeros((1, 4)), np.zeros(5), [[0.0], [np.nan]]])
def test_too_little_is_refused(values: object) -> None:
    with pytest.raises(InputError, match="at least 2 samples"):
        bootstrap_means(values)  # type: ignore[arg-type]


def test_the_nested_interval_knows_how_much_groups_differ() -> None:
    """Groups that differ by far more than samples: the interval of the mean of their means."""
    rng = np.random.default_rng(3)
    levels = np.array([0.0, 1.0, 2.0, 5.0])
    values = levels[:, None, None] + 1e-3 * rng.normal(size=(4, 50, 2))
    flat = bootstrap_means(values.reshape(-1, 2))[0]
    found = nested_bootstrap_means(values)[0]
    assert found.value == pytest.approx(2.0, abs=1e-3)
    means = [rng.choice(levels, 4).mean() for _ in range(20000)]
    low, high = np.quantile(means, [0.025, 0.975])
    assert found.low == pytest.approx(low, abs=0.15)
    assert found.high == pytest.approx(high, abs=0.15)
    assert found.high - found.low > 4 * (flat.high - flat.low)


def test_groups_that_are_alike_leave_the_interval_over_samples() -> None:
    sample = np.random.default_rng(4).normal(size=(200, 1))
    nested = nested_bootstrap_means(np.stack([sample] * 3))[0]
    plain = bootstrap_means(sample)[0]
    assert nested.low == pytest.approx(plain.low, abs=0.03)
    assert nested.high == pytest.approx(plain.high, abs=0.03)


@pytest.mark.parametrize("shape", [(1, 5, 2), (3, 1, 2), (3, 5)])
def test_a_nested_interval_needs_groups_and_samples(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="at least 2 groups of 2 samples"):
        nested_bootstrap_means(np.zeros(shape))
