"""Figures of operators against definitions written out another way."""

from dataclasses import replace

import numpy as np
import pytest

from eitbench.benchmark.metrics.operator_metrics import (
    Standard,
    coarse_gradient,
    correlation,
    cosine,
    mse,
    relative_error,
)
from eitbench.scenarios import InputError, forward_model, sensor

RNG = np.random.default_rng(5)
VALIDATION = RNG.normal(3.0, [0.1, 1.0, 10.0], (400, 3))
STANDARD = Standard.of(VALIDATION)
TRUTH = RNG.normal(3.0, [0.1, 1.0, 10.0], (50, 3))


def test_always_answering_the_mean_has_an_mse_of_1_on_the_validation_data() -> None:
    errors = mse(VALIDATION, np.broadcast_to(STANDARD.mean, VALIDATION.shape), STANDARD)
    assert errors.shape == (400,)
    assert errors.mean() == pytest.approx(1, rel=1e-12)


def test_every_measurement_weighs_alike() -> None:
    for k, spread in enumerate(VALIDATION.std(axis=0)):
        off = TRUTH.copy()
        off[:, k] += 0.5 * spread
        np.testing.assert_allclose(mse(TRUTH, off, STANDARD), 0.25 / 3, rtol=1e-10)


def test_correlation_is_pearsons_over_all_responses() -> None:
    untouched = STANDARD.mean
    estimate = TRUTH + RNG.normal(0, [0.02, 0.5, 1.0], TRUTH.shape)
    expected = np.corrcoef((TRUTH - untouched).ravel(), (estimate - untouched).ravel())[0, 1]
    assert correlation(TRUTH, estimate, untouched).value == pytest.approx(expected, rel=1e-12)
    assert correlation(TRUTH, 2 * TRUTH - untouched, untouched).value == pytest.approx(1)
    for constant in (untouched, untouched + 3.0):
        same = np.broadcast_to(constant, TRUTH.shape)
        assert np.isnan(correlation(TRUTH, same, untouched).value)
    assert np.isnan(correlation(TRUTH[:0], TRUTH[:0], untouched).value)
    one = correlation(TRUTH[:1], estimate[:1], untouched)
    assert one.value == pytest.approx(
        np.corrcoef(TRUTH[0] - untouched, estimate[0] - untouched)[0, 1]
    )
    assert np.isnan([one.low, one.high]).all()


@pytest.mark.slow
def test_the_interval_of_a_correlation_draws_whole_clusters() -> None:
    """A few strong touches rule R, so that samples within them are no evidence of their own."""
    rng = np.random.default_rng(4)
    strength = np.repeat(rng.lognormal(0, 1, 40), 5)[:, None]
    truth = strength * rng.normal(size=(200, 12))
    estimate = truth + 0.3 * strength**1.5 * rng.normal(size=(200, 12))
    of = np.repeat(np.arange(40), 5)
    none = np.zeros(12)
    found = correlation(truth, estimate, none, of)
    slow = [
        correlation(truth[rows], estimate[rows], none).value
        for rows in (
            np.concatenate([np.flatnonzero(of == k) for k in rng.integers(40, size=40)])
            for _ in range(1000)
        )
    ]
    assert found.low == pytest.approx(np.quantile(slow, 0.023), abs=0.02)
    assert found.high == pytest.approx(np.quantile(slow, 0.977), abs=0.02)
    alone = correlation(truth, estimate, none)
    assert alone.value == found.value
    assert alone.high - alone.low < 0.8 * (found.high - found.low)


def test_relative_error_is_not_standardised() -> None:
    np.testing.assert_allclose(relative_error(TRUTH, 1.25 * TRUTH), 0.25)


def test_a_measurement_that_never_changes_cannot_be_standardised() -> None:
    constant = VALIDATION.copy()
    constant[:, 1] = 2.0
    with pytest.raises(InputError, match=r"Measurement 1 .* 400"):
        Standard.of(constant)


def test_cosine_is_of_the_direction_alone_and_zero_has_none() -> None:
    first = np.array([[1.0, 0.0], [1.0, 1.0], [2.0, 1.0], [0.0, 0.0]])
    second = np.array([[0.0, 7.0], [-3.0, -3.0], [20.0, 10.0], [1.0, 0.0]])
    cosines, undefined = cosine(first, second)
    np.testing.assert_allclose(cosines, [0, -1, 1, 0], atol=1e-15)
    assert undefined.tolist() == [False, False, False, True]


def test_the_gradient_of_a_finer_mesh_is_that_of_coarse_pixels() -> None:
    """Against differences of the fine model's voltages when one coarse pixel changes."""
    nominal = replace(sensor("foam16"), image_shape=(8, 12))
    fine = forward_model(nominal.refined(2))
    coarse = RNG.uniform(0.5, 1.0, nominal.image_shape)
    weights = RNG.normal(size=nominal.n_measurements)
    image = np.kron(coarse, np.ones((2, 2)))
    _, fields = fine.voltages_and_fields(image[None])
    gradient = coarse_gradient(fine.pullback(fields, weights[None]), nominal.image_shape)[0]
    assert gradient.shape == (8, 12)
    for pixel in [(0, 0), (3, 7), (7, 11)]:
        step = np.zeros(nominal.image_shape)
        step[pixel] = 1e-4
        wide = np.kron(step, np.ones((2, 2)))
        change = weights @ (fine.voltages(image + wide) - fine.voltages(image - wide)) / 2e-4
        assert gradient[pixel] == pytest.approx(change, rel=1e-5)
