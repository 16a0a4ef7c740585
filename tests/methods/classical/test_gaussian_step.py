"""The Gaussian posterior of the one-step methods, beside its covariance and the law of its data."""

import numpy as np
import pytest
from scipy import linalg, stats

from eitbench.methods import Problem
from eitbench.methods.classical import one_step
from eitbench.methods.classical.linearisation import VARIABLES, Variable
from eitbench.methods.classical.noser import Noser
from eitbench.methods.classical.one_step import GaussianStep
from eitbench.methods.classical.tikhonov import Tikhonov
from eitbench.methods.method import DRAWS
from eitbench.methods.problem import no_split
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.suite import scenario_by_name

WEIGHT = 0.1


def _coarse(low: float, high: float) -> Problem:
    """A coarse square whose conductivity is within these multiples of the background."""
    coarse = scenario_by_name("quick").model_copy(
        update={"image_shape": (16, 16), "conductivity_range": (low, high)}
    )
    model = forward_model(coarse.nominal_sensor)
    return Problem(coarse.nominal_sensor, model.voltages(model.background), no_split)


@pytest.fixture(scope="module")
def problem() -> Problem:
    """A square whose conductivity varies by half the background."""
    return _coarse(0.5, 1.5)


def _prior(method: GaussianStep, jacobian: Array) -> tuple[Array, float]:
    """Variances of the pixels, as large as those of a uniform law from 0.5 to 1.5; of the noise."""
    variances = method.variances(jacobian)
    variances = variances / 12 / variances.mean()
    return variances, WEIGHT * np.trace(jacobian * variances @ jacobian.T) / len(jacobian)


@pytest.mark.parametrize("kind", [Noser, Tikhonov])
def test_draws_have_the_covariance_of_the_posterior(
    problem: Problem, kind: type[GaussianStep], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of many draws; (C^-1 + J^T J / w)^-1 by the pixels is what the measurements give."""
    monkeypatch.setattr(one_step, "OFFSETS", 20_000)
    method = kind(WEIGHT)
    method.fit(problem)
    jacobian = problem.jacobian[:, problem.mask]
    variances, noise = _prior(method, jacobian)
    precision = np.diag(1 / variances) + jacobian.T @ jacobian / noise
    exact = linalg.inv(precision)
    drawn = np.cov(method._offsets.T)
    scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    np.testing.assert_allclose(drawn / scale, exact / scale, atol=5 / np.sqrt(20_000))


@pytest.mark.parametrize("variable", VARIABLES)
@pytest.mark.parametrize("high", [1.0, 2.0])
def test_draws_are_normal_about_the_image_whatever_the_range(
    variable: Variable, high: float
) -> None:
    """Kept within it, half of them would equal the background, and with it most true pixels."""
    method = Noser(WEIGHT, variable)
    problem = _coarse(0.05, high)
    method.fit(problem)
    noise = np.random.default_rng(3).standard_normal((400, len(problem.reference)))
    frames = problem.reference + 1e-5 * noise
    offsets = (method.uncertainty(frames) - method.reconstruct(frames)[:, None])[..., problem.mask]
    below = (offsets < 0).mean()
    assert below == pytest.approx(0.5, abs=0.02)
    assert np.abs(offsets.mean(axis=(0, 1)) / offsets.std(axis=(0, 1))).max() < 0.2
    assert stats.kurtosis(offsets / offsets.std(axis=(0, 1)), axis=None) == pytest.approx(0, abs=1)


@pytest.mark.parametrize("kind", [Noser, Tikhonov])
def test_the_truth_is_one_more_draw(problem: Problem, kind: type[GaussianStep]) -> None:
    """Frames of the linear model, from the prior: ranks are uniform."""
    method = kind(WEIGHT)
    method.fit(problem)
    jacobian = problem.jacobian[:, problem.mask]
    variances, noise = _prior(method, jacobian)
    rng = np.random.default_rng(7)
    x = np.sqrt(variances) * rng.standard_normal((120, jacobian.shape[1]))
    frames = x @ jacobian.T + np.sqrt(noise) * rng.standard_normal((120, len(jacobian)))
    images = method.reconstruct(problem.reference + frames)
    offsets = (method.uncertainty(problem.reference + frames) - images[:, None])[..., problem.mask]
    # About the linear mean: images are kept within the range.
    rank = ((frames @ method._matrix)[:, None] + offsets < x[:, None]).sum(axis=1)
    for level, out in ((0.5, 10), (0.8, 4), (0.95, 1)):
        within = np.mean((rank >= out) & (rank <= DRAWS - out))
        assert within == pytest.approx(level, abs=0.02)
