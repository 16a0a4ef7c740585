"""Draws of the posterior beside the same by brute force."""

import math
from functools import cache

import numpy as np
import pytest
from scipy import special, stats
from tests.support.small_sensors import foam

from eitbench.benchmark.ceiling import sampler
from eitbench.benchmark.ceiling.agreement import traces
from eitbench.benchmark.ceiling.importance import draws_about
from eitbench.benchmark.ceiling.models import PhantomModels, images
from eitbench.benchmark.ceiling.moves import PROPOSALS, Proposals
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.benchmark.ceiling.sampler import (
    CHECKED,
    Draws,
    Particles,
    Sampler,
    effective,
    library,
    merged,
)
from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.imperfections.noise import add_noise
from eitbench.scenarios.phantoms.families import FAMILIES
from eitbench.scenarios.phantoms.phantom import draw, rasterise
from eitbench.scenarios.physics.forward import ForwardModel

SENSOR = foam((32, 32))
NAMES = ("circle", "triangle")
SOFT = ("circle", "soft-press")
"""The second family has two shapes, each drawn half of the time."""
SEVERAL = ("rectangle", "two-circles")
"""Phantoms that several vectors give."""
SNR_DB = 18.0
MANY = 6000
"""Draws of each shape for brute force."""


@cache
def made(
    names: tuple[str, ...] = NAMES,
) -> tuple[PhantomModels, Particles, tuple[Index, Array], Array]:
    """Models, draws for the sampler, others for brute force, and their exact predictions."""
    priors = tuple(prior for name in names for prior in FamilyPrior.of(FAMILIES[name], SENSOR))
    models = PhantomModels(priors, ForwardModel(SENSOR))
    begin, rng = library(models, np.random.default_rng(0)), np.random.default_rng(1)
    drawn = [prior.draw(MANY, rng) for prior in priors]
    longest = max(vectors.shape[1] for vectors in drawn)
    families = np.repeat(np.arange(len(priors)), MANY)
    vectors = np.concatenate([np.pad(v, ((0, 0), (0, longest - v.shape[1]))) for v in drawn])
    return models, begin, (families, vectors), models.exact(families, vectors)


@pytest.mark.slow
@pytest.mark.parametrize("proposals", PROPOSALS)
@pytest.mark.parametrize(
    ("names", "name", "snr_db", "enough"),
    [
        (NAMES, "circle", SNR_DB, sampler.AIMED),
        (NAMES, "triangle", SNR_DB, sampler.AIMED),
        (NAMES, "triangle", SNR_DB, 1.8),  # so that one batch of checked particles does not do
        (SEVERAL, "two-circles", 10.0, sampler.AIMED),
        (SOFT, "circle", SNR_DB, sampler.AIMED),
        (SOFT, "soft-press", 6.0, sampler.AIMED),  # firm, and strong in the frame
        # No weights do, so that particles go on by exact solutions.
        (NAMES, "triangle", SNR_DB, math.inf),
        (SEVERAL, "two-circles", 10.0, math.inf),
        (SOFT, "soft-press", 6.0, math.inf),
    ],
)
def test_mean_width_and_families_are_those_of_brute_force(
    names: tuple[str, ...],
    name: str,
    snr_db: float,
    enough: float,
    proposals: Proposals,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Against 6,000 draws of the generator of each shape, weighed by the exact likelihood."""
    models, begin, (of, vectors), exact = made(names)
    rng = np.random.default_rng(7)
    truth = rasterise(draw(FAMILIES[name], SENSOR, rng), SENSOR)
    frame = models.frame(add_noise(ForwardModel(SENSOR).voltages(truth), snr_db, rng), snr_db)
    shares = np.array([prior.share for prior in models.priors])
    log_weights = frame.log_likelihood(exact) + np.log(shares)[of]
    assert effective(log_weights) > 150
    weights = special.softmax(log_weights)
    families = [prior.parameters for prior in models.priors]
    painted = images(families, of, vectors)
    expected = np.tensordot(weights, painted, axes=1)
    variance = np.tensordot(weights, (painted - expected) ** 2, axes=1).mean()
    monkeypatch.setattr(sampler, "AIMED", enough)
    drawn = Sampler(models, begin, proposals).draws(frame, np.random.default_rng(2))
    assert drawn.effective > (0.5 if enough == math.inf else enough)
    assert enough == 1 or len(drawn.weights) > CHECKED
    fits = frame.log_likelihood(models.exact(drawn.families, drawn.vectors))
    np.testing.assert_allclose(drawn.log_likelihoods, fits, rtol=1e-9)
    own = images(families, drawn.families, drawn.vectors)
    mean = np.tensordot(drawn.weights, own, axes=1)
    assert np.mean((mean - expected) ** 2) < 0.05 * variance
    spread = np.tensordot(drawn.weights, (own - mean) ** 2, axes=1).mean()
    assert spread == pytest.approx(variance, rel=0.2)
    likely = np.bincount(drawn.families, drawn.weights, minlength=len(families))
    expected = np.bincount(of, weights, minlength=len(families))
    np.testing.assert_allclose(likely, expected, atol=0.12)
    evidence = special.logsumexp(log_weights) - np.log(MANY)
    assert drawn.log_evidence == pytest.approx(evidence, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["circle", "triangle", "soft-press"])
def test_draws_about_the_true_phantom_are_those_of_the_sampler_and_their_evidence_is_no_more(
    name: str,
) -> None:
    """Where the posterior is narrow, and the sampler has not lost the truth."""
    priors = FamilyPrior.of(FAMILIES[name], SENSOR)[:1]
    models, rng = PhantomModels(priors, ForwardModel(SENSOR)), np.random.default_rng(2)
    phantom = draw(priors[0].parameters.family, SENSOR, rng)
    family, vector = models.of_phantom(phantom)
    parameters, truth = [priors[0].parameters], rasterise(phantom, SENSOR)
    painted = images(parameters, family, vector)[0] * SENSOR.background
    np.testing.assert_allclose(painted, truth)
    frame = models.frame(add_noise(ForwardModel(SENSOR).voltages(truth), 25.0, rng), 25.0)
    begin = library(models, np.random.default_rng(0))
    whole = Sampler(models, begin, "walk").draws(frame, np.random.default_rng(3))
    about = draws_about(models, family, vector, frame, np.random.default_rng(3))
    assert -1.2 < about.log_evidence - whole.log_evidence < 0.2
    assert about.effective > sampler.CORRECTED
    fits = frame.log_likelihood(models.exact(about.families, about.vectors))
    np.testing.assert_allclose(about.log_likelihoods, fits, rtol=1e-9)
    mean, expected = (
        np.tensordot(of.weights, images(parameters, of.families, of.vectors), axes=1)
        for of in (about, whole)
    )
    spread = (images(parameters, whole.families, whole.vectors) - expected) ** 2
    variance = np.tensordot(whole.weights, spread, axes=1).mean()
    assert np.mean((mean - expected) ** 2) < 0.2 * variance


def run_of(effective: float, log_evidence: float, vector: float) -> Draws:
    """A run of two draws."""
    vectors, weights = np.full((2, 1), vector), np.array([0.25, 0.75])
    fits = 10 * vectors[:, 0]
    return Draws(np.zeros(2, int), vectors, weights, fits, effective, log_evidence)


def test_exact_runs_weigh_as_their_evidence() -> None:
    one, other = run_of(0.5, -700.0, 1.0), run_of(0.9, -700.0 + np.log(3), 2.0)
    found = merged([one, run_of(0.1, -700.0, 3.0), other])
    np.testing.assert_allclose(found.weights, [0.0625, 0.1875, 0.1875, 0.5625])
    np.testing.assert_array_equal(found.vectors[:, 0], [1, 1, 2, 2])
    np.testing.assert_array_equal(found.log_likelihoods, [10, 10, 20, 20])
    assert found.effective == 0.9
    assert found.log_evidence == pytest.approx(-700 + np.log(2))


def test_runs_of_which_none_is_exact_weigh_alike() -> None:
    found = merged([run_of(0.1, -705.0, 1.0), run_of(0.2, -700.0, 2.0)])
    np.testing.assert_allclose(found.weights, [0.125, 0.375, 0.125, 0.375])
    assert found.effective == 0.2


def test_a_run_that_lost_what_is_likely_does_not_count_even_if_exact() -> None:
    found = merged([run_of(0.9, -710.0, 1.0), run_of(0.1, -700.0, 2.0)])
    np.testing.assert_array_equal(found.vectors[:, 0], [2, 2])
    assert found.effective == 0.1


@pytest.mark.slow
def test_draws_are_phantoms_that_fit() -> None:
    models, begin, *_ = made()
    rng = np.random.default_rng(3)
    truth = rasterise(draw(FAMILIES["circle"], SENSOR, rng), SENSOR)
    frame = models.frame(add_noise(ForwardModel(SENSOR).voltages(truth), SNR_DB, rng), SNR_DB)
    drawn = Sampler(models, begin, "walk").draws(frame, rng)
    assert drawn.weights.sum() == pytest.approx(1)
    for family, vector in zip(drawn.families, drawn.vectors, strict=True):
        prior = models.priors[family]
        assert prior.fitting(vector[None]).all()


@pytest.mark.slow
def test_the_same_generator_gives_the_same_draws() -> None:
    models, begin, *_ = made()
    frame = models.frame(ForwardModel(SENSOR).voltages(np.full((32, 32), 0.9)), SNR_DB)
    found = [
        Sampler(models, begin, "differences").draws(frame, np.random.default_rng(4))
        for _ in range(2)
    ]
    np.testing.assert_array_equal(found[0].vectors, found[1].vectors)
    np.testing.assert_array_equal(found[0].weights, found[1].weights)


@pytest.mark.nightly
@pytest.mark.parametrize("proposals", PROPOSALS)
def test_true_phantoms_have_uniform_ranks_among_draws(proposals: Proposals) -> None:
    """Simulation-based calibration: true phantoms are draws of the prior, as particles are."""
    models, begin, *_ = made()
    exact, families = ForwardModel(SENSOR), [prior.parameters for prior in models.priors]
    ranks = []
    for k in range(40):
        rng = np.random.default_rng([8, k])
        truth = rasterise(draw(FAMILIES[NAMES[k % 2]], SENSOR, rng), SENSOR)
        frame = models.frame(add_noise(exact.voltages(truth), 25.0, rng), 25.0)
        drawn = Sampler(models, begin, proposals).draws(frame, rng)
        found = traces(images(families, drawn.families, drawn.vectors), SENSOR)
        (true,) = traces(truth[None], SENSOR)
        ties = rng.random(len(true)) * (drawn.weights @ (found == true))
        ranks.append(drawn.weights @ (found < true) + ties)
    of = np.array(ranks).T
    assert min(stats.kstest(rank, "uniform").pvalue for rank in of) > 0.01 / len(of)
    for level, error in ((0.5, 0.15), (0.8, 0.12), (0.95, 0.07)):
        assert (np.abs(of - 0.5) <= level / 2).mean() == pytest.approx(level, abs=error)
