"""The posterior of shapes beside the same by brute force."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special
from tests.support.small_sensors import clean_problem, foam

from eitbench.methods.shapes.fit import FrameModel, fit_frame
from eitbench.methods.shapes.parameters import Parameters
from eitbench.methods.shapes.posterior import Sampler, Student, resampled, rise
from eitbench.scenarios.phantoms.families import FAMILIES

Array = NDArray[np.float64]
SENSOR = foam((32, 32))
TRUTH = np.array([0.55, 0.45, 0.14, 0.5])


def test_particles_start_with_the_density_that_is_said() -> None:
    """The mean of p / q over samples of q is 1 for the density p of a normal distribution."""
    root = np.array([[0.3, 0.0], [0.2, 0.5]])
    start = Student(np.array([1.0, -2.0]), root)
    vectors = start.draw(40000, np.random.default_rng(0))
    assert vectors[0] == pytest.approx(start.centre)
    whitened = np.linalg.solve(root, (vectors - start.centre).T)
    normal = -(whitened**2).sum(axis=0) / 2 - np.log(2 * np.pi) - np.log(np.diag(root)).sum()
    assert np.exp(normal - start.log_density(vectors)).mean() == pytest.approx(1, abs=0.02)


def test_a_step_leaves_enough_particles() -> None:
    rng = np.random.default_rng(0)
    even, uneven = 0.1 * rng.standard_normal(200), 50 * rng.standard_normal(200)
    assert rise(even, 0.7, 100) == 0.7
    found = rise(uneven, 1.0, 20)
    weights = special.softmax(found * uneven)
    assert 0 < found < 1
    assert 1 / (weights @ weights) == pytest.approx(20, rel=0.02)


def test_particles_are_drawn_as_often_as_their_weight_says() -> None:
    weights = np.array([0.5, 0.001, 0.299, 0.2])
    counts = np.bincount(resampled(weights, 1000, np.random.default_rng(0)), minlength=4)
    assert np.abs(counts - 1000 * weights).max() <= 1


@pytest.mark.slow
def test_mean_image_and_evidence_are_those_of_brute_force() -> None:
    """Against 40,000 samples of the prior in a box about the fit, through the exact model."""
    parameters, model = Parameters(FAMILIES["circle"], SENSOR), FrameModel(clean_problem(SENSOR))
    rng = np.random.default_rng(0)
    clean = model.differences(parameters.image(TRUTH))
    noise = 0.3 * np.linalg.norm(clean) / np.sqrt(model.count)
    data = clean + noise * rng.standard_normal(model.count)
    fit = fit_frame(parameters, TRUTH, model, data, 20)

    found = [
        Sampler(model, data, 500, 50).posterior(fit, 9 * fit.error, np.random.default_rng(seed))
        for seed in range(4)
    ]
    covariance = np.linalg.inv(fit.information * model.count / fit.error)
    half = 3.5 * np.sqrt(np.diag(covariance)) * parameters.step
    low = np.maximum(fit.vector - half, parameters.low)
    high = np.minimum(fit.vector + half, parameters.high)
    vectors = rng.uniform(low, high, (40_000, 4))
    images = parameters.images(vectors)
    errors = np.concatenate([
        ((data - model.data(_voltages(model, part))) ** 2).sum(axis=1)
        for part in np.array_split(images, 40)
    ])  # fmt: skip
    log_likelihood = -model.count / 2 * np.log(errors)
    weights = special.softmax(log_likelihood)
    assert 1 / (weights @ weights) > 100  # the reference is no better than that
    mean = np.tensordot(weights, images, axes=1)
    volume = np.log((high - low) / parameters.span).sum()
    evidence = special.logsumexp(log_likelihood) - np.log(len(vectors)) + volume
    spread = np.sqrt(np.tensordot(weights, (images - mean) ** 2, axes=1))
    means = np.array([posterior.images.mean(axis=0) for posterior in found])
    missed = np.linalg.norm(means - mean, axis=(1, 2)) / np.linalg.norm(spread)
    assert missed.max() < 0.5
    assert np.linalg.norm(means.mean(axis=0) - mean) < 0.3 * np.linalg.norm(spread)
    for posterior in found:
        assert posterior.log_evidence == pytest.approx(evidence, abs=0.4)


def _voltages(model: FrameModel, images: Array) -> Array:
    problem = model._problem
    return np.asarray(
        problem.model.voltages(images * problem.background) - problem.background_voltages
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "truth"), [("circle", TRUTH), ("ring", np.array([0.5, 0.55, 0.25, 0.5, 0.6]))]
)
def test_without_noise_the_pixels_are_found(name: str, truth: Array) -> None:
    """A soft fit leaves what edges of whole pixels differ by; particles get to the very image."""
    parameters, model = Parameters(FAMILIES[name], SENSOR), FrameModel(clean_problem(SENSOR))
    image = parameters.image(truth)
    data = model.differences(image)
    fit = fit_frame(parameters, truth + 0.3 * parameters.step, model, data, 20)
    assert fit.error > 1e-6 * data @ data
    rng = np.random.default_rng(0)
    found = Sampler(model, data, 200, 100).posterior(fit, 4e-3 * float(data @ data), rng)
    assert found.power == 1
    assert found.error < 1e-14 * data @ data
    assert np.abs(found.images.mean(axis=0) - image).max() < 1e-6


def test_a_family_without_a_possible_sample_has_no_evidence() -> None:
    """A disc that is fitted beside the rim, where no disc of that size has room."""
    parameters, model = Parameters(FAMILIES["circle"], SENSOR), FrameModel(clean_problem(SENSOR))
    vector = np.array([0.02, 0.5, 0.2, 0.3])
    data = model.differences(parameters.image(vector))
    fit = fit_frame(parameters, vector, model, data, 5)
    found = Sampler(model, data, 60, 2).posterior(fit, 1e-4 * fit.error, np.random.default_rng(0))
    assert found.log_evidence == -np.inf
