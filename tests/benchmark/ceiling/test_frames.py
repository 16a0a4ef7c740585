"""Likelihoods against full covariances, and the stand-in against the exact model."""

import numpy as np
import pytest
from scipy import stats
from tests.support.small_sensors import foam

from eitbench.benchmark.ceiling.frames import Errors
from eitbench.benchmark.ceiling.models import PhantomModels, StandIn
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.phantoms.phantom import draw, rasterise
from eitbench.scenarios.physics.forward import ForwardModel

SENSOR = foam((20, 20))
NAMES = ("circle", "rectangle")
PRIORS = tuple(prior for name in NAMES for prior in FamilyPrior.of(FAMILIES[name], SENSOR))


@pytest.fixture(scope="module")
def models() -> PhantomModels:
    return PhantomModels(PRIORS, ForwardModel(SENSOR))


def test_exact_predictions_are_those_of_the_generator(models: PhantomModels) -> None:
    exact, rng = ForwardModel(SENSOR), np.random.default_rng(0)
    families = np.array([0, 1] * 5)
    phantoms = [draw(FAMILIES[NAMES[k]], SENSOR, rng) for k in families]
    vectors = np.zeros((10, 6))
    for row, k, phantom in zip(vectors, families, phantoms, strict=True):
        vector = PRIORS[k].parameters.of_phantom(phantom)
        row[: len(vector)] = vector
    frames = np.array([exact.voltages(rasterise(phantom, SENSOR)) for phantom in phantoms])
    predicted = models.exact(families, vectors)
    # Combinations keep the sum of squares: reciprocal measurements are equal without noise.
    np.testing.assert_allclose((predicted**2).sum(axis=1), (frames**2).sum(axis=1), rtol=1e-9)
    for frame, own in zip(frames, predicted, strict=True):
        np.testing.assert_allclose(models.frame(frame, 50.0).data, own, rtol=1e-9)


def test_the_likelihood_is_that_of_all_measurements(models: PhantomModels) -> None:
    """Of 208 measurements with the noise of the generator, in place of 104 combinations."""
    exact, rng = ForwardModel(SENSOR), np.random.default_rng(1)
    phantoms = [draw(FAMILIES["circle"], SENSOR, rng) for _ in range(4)]
    frames = np.array([exact.voltages(rasterise(phantom, SENSOR)) for phantom in phantoms])
    seen = add_noise(frames[0], 35.0, rng)
    frame = models.frame(seen, 35.0)
    found = frame.log_likelihood(np.array([models.frame(f, 35.0).data for f in frames]))
    expected = [
        stats.norm(f, np.sqrt(np.mean(f**2)) * 10 ** (-35 / 20)).logpdf(seen).sum() for f in frames
    ]
    np.testing.assert_allclose(found - found[0], np.subtract(expected, expected[0]), rtol=1e-8)


def test_errors_are_noise_with_their_covariance(models: PhantomModels) -> None:
    rng = np.random.default_rng(2)
    exact = ForwardModel(SENSOR)
    voltages = exact.voltages(rasterise(draw(FAMILIES["circle"], SENSOR, rng), SENSOR))
    frame = models.frame(add_noise(voltages, 40.0, rng), 40.0)
    predicted = models.frame(voltages, 40.0).data + 1e-3 * rng.standard_normal((3, len(frame.data)))
    # The deviation of the noise would differ from one prediction to the next: only a little.
    s = frame.deviation(predicted)
    directions = np.linalg.qr(rng.standard_normal((len(frame.data), 2)))[0].T
    errors = Errors(np.array([9.0, 2.0]), directions, 0.5)
    for b in (1.0, 0.1):
        found = frame.log_likelihood(predicted, b, errors)
        shape = directions.T * errors.variances @ directions
        shape += (1 / b + 0.5) * np.eye(len(frame.data))
        sharp = b / (1 + b * 0.5)
        expected = [
            -0.5 * (r @ np.linalg.solve(shape, r)) / s_**2
            - sharp * (frame.measurements * np.log(s_) + frame.rest / (2 * s_**2))
            for r, s_ in zip(frame.data - predicted, s, strict=True)
        ]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_a_stand_in_that_is_affine_is_found_and_does_not_err() -> None:
    rng = np.random.default_rng(3)
    quick = rng.standard_normal((60, 4)) @ rng.standard_normal((4, 30)) + 5
    exact = quick @ (np.eye(30) + 0.1 * rng.standard_normal((30, 30))) + rng.standard_normal(30)
    fitted = StandIn.fitted(quick[:40], exact[:40])
    np.testing.assert_allclose(fitted(quick[40:]), exact[40:], atol=1e-4)
    assert np.abs(fitted.errors).max() < 1e-4


def test_errors_of_a_stand_in_are_those_of_new_phantoms() -> None:
    """What is left of each by a fit to the others has the size that new ones show."""
    rng = np.random.default_rng(4)
    quick = rng.standard_normal((4040, 6)) @ rng.standard_normal((6, 30))
    exact = 1.1 * quick + 0.2 * rng.standard_normal(quick.shape)
    fitted = StandIn.fitted(quick[:40], exact[:40])
    said = np.square(fitted.errors).sum()
    seen = np.square(fitted(quick[40:]) - exact[40:]).sum(axis=1).mean()
    assert said == pytest.approx(seen, rel=0.2)


def test_the_stand_in_comes_near_to_a_finer_mesh() -> None:
    """About one phantom near the rim, it leaves less than half of what the quick model errs by."""
    models, rng = PhantomModels(PRIORS, ForwardModel(foam((160, 160)))), np.random.default_rng(5)
    vectors = np.zeros((80, 6))
    vectors[:, :4] = [0.8, 0.25, 0.15, 0.2]
    vectors[:, :4] += [0.005, 0.005, 0.005, 0.02] * rng.standard_normal((80, 4))
    families = np.zeros(80, dtype=np.int64)
    quick, right = models.quick(families, vectors), models.exact(families, vectors)
    errors = [
        np.sqrt(np.mean((stand_in(quick) - right)[50:] ** 2))
        for stand_in in (models.untouched(), StandIn.fitted(quick[:50], right[:50]))
    ]
    assert errors[1] < 0.5 * errors[0]
