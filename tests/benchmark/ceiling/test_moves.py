"""Moves by an emulator beside the distribution that they must keep."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from tests.support.small_sensors import foam

from eitbench.benchmark.ceiling.moves import PROPOSALS, Emulator, Moves, Proposals
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.phantoms.families import FAMILIES

SENSOR = foam((24, 24))


def test_an_emulator_is_right_for_a_quadratic() -> None:
    rng = np.random.default_rng(0)
    coordinates = 3 + np.array([1e-3, 1.0, 50.0]) * rng.standard_normal((200, 3))
    linear, square = rng.standard_normal((3, 5)), rng.standard_normal((3, 3, 5))

    def quadratic(at: Array) -> Array:
        away = (at - 3) / np.array([1e-3, 1.0, 50.0])
        return np.asarray(2 + away @ linear + np.einsum("ni,nj,ijk->nk", away, away, square))

    emulator = Emulator.fitted(coordinates, quadratic(coordinates))
    new = 3 + np.array([1e-3, 1.0, 50.0]) * rng.standard_normal((20, 3))
    np.testing.assert_allclose(emulator(new), quadratic(new), rtol=1e-3, atol=1e-3)


def test_an_emulator_of_particles_that_are_alike_is_finite() -> None:
    alike = np.tile([0.2, 0.4], (30, 1))
    emulator = Emulator.fitted(alike, np.ones((30, 3)))
    np.testing.assert_allclose(emulator(alike), 1, rtol=1e-3)


@pytest.mark.parametrize("proposals", PROPOSALS)
@pytest.mark.parametrize(
    "name",
    [
        "circle",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("rectangle", "two-circles")),
    ],
)
def test_without_a_frame_moves_keep_the_law_of_phantoms(name: str, proposals: Proposals) -> None:
    """Every parameter of moved draws of the generator is distributed as that of others."""
    (prior,), rng = FamilyPrior.of(FAMILIES[name], SENSOR), np.random.default_rng(1)
    begin, others = prior.draw(1000, rng), prior.draw(1000, rng)
    moves = Moves.about(prior, begin, np.zeros((1000, 1)))
    begin, others = (prior.arranged(of, moves.centre) for of in (begin, others))

    def log_likelihood(predictions: Array) -> Array:
        return np.zeros(len(predictions))

    state, shares = moves.state(begin, log_likelihood), []
    for _ in range(40):
        state, share = moves.moved(state, 0.3, log_likelihood, proposals, rng)
        shares.append(share)
    assert np.mean(shares) > 0.1
    assert np.mean((state.vectors != begin).any(axis=1)) > 0.95
    assert prior.fitting(state.vectors).all()
    columns = zip(state.vectors.T, others.T, strict=True)
    found = [stats.ks_2samp(moved, drawn).pvalue for moved, drawn in columns]
    assert min(found) > 0.01 / len(found)


@pytest.mark.slow
@pytest.mark.parametrize("proposals", PROPOSALS)
def test_moves_to_another_vector_of_a_phantom_are_refused(proposals: Proposals) -> None:
    """Steps unlike in the two inclusions: taken over the border, they would not keep the law."""
    (prior,), rng = FamilyPrior.of(FAMILIES["two-circles"], SENSOR), np.random.default_rng(1)
    begin, others = prior.draw(2000, rng), prior.draw(2000, rng)
    about = Moves.about(prior, begin, np.zeros((2000, 1)))
    unlike = np.repeat([0.1, 1.0], 4)
    moves = replace(
        about, root=unlike[:, None] * about.root, coordinates=unlike * about.coordinates
    )

    def log_likelihood(predictions: Array) -> Array:
        return np.zeros(len(predictions))

    state = moves.state(begin, log_likelihood)
    for _ in range(60):
        state, _ = moves.moved(state, 0.9, log_likelihood, proposals, rng)
    columns = zip(state.vectors.T, prior.arranged(others, moves.centre).T, strict=True)
    found = [stats.ks_2samp(moved, drawn).pvalue for moved, drawn in columns]
    assert min(found) > 0.01 / len(found)


@pytest.mark.parametrize("proposals", PROPOSALS)
def test_moves_go_to_where_the_emulator_says(proposals: Proposals) -> None:
    """The mean and the width of a place whose likelihood is normal and narrow."""
    (prior,), rng = FamilyPrior.of(FAMILIES["circle"], SENSOR), np.random.default_rng(2)
    begin = prior.draw(600, rng)
    moves = Moves.about(prior, begin, begin[:, :2])  # predictions: the place itself

    def log_likelihood(predictions: Array) -> Array:
        return np.asarray(-(((predictions - [0.4, 0.6]) / 0.02) ** 2).sum(axis=1) / 2)

    state = moves.state(begin, log_likelihood)
    for _ in range(150):
        state, _ = moves.moved(state, 0.02, log_likelihood, proposals, rng)
    places = state.vectors[:, :2]
    np.testing.assert_allclose(places.mean(axis=0), [0.4, 0.6], atol=4 * 0.02 / np.sqrt(300))
    np.testing.assert_allclose(places.std(axis=0), 0.02, rtol=0.15)


@pytest.mark.parametrize("name", ["circle", "ring", "triangle", "rectangle", "two-circles"])
def test_scattered_vectors_tell_the_integral_of_a_density(name: str) -> None:
    """That of the law of phantoms is 1, and its conductivities are uniform."""
    (prior,), rng = FamilyPrior.of(FAMILIES[name], SENSOR), np.random.default_rng(2)
    moves = Moves.about(prior, prior.draw(200, rng), np.zeros((200, 1)))
    vectors, log_weights = moves.scattered(5000, rng)
    weights = np.exp(log_weights) / 5000
    deviation = float(np.sqrt(weights @ weights))
    assert deviation < 0.1
    assert weights.sum() == pytest.approx(1, abs=4 * deviation)
    scaled = (vectors[:, -1] - prior.parameters.low[-1]) / prior.parameters.span[-1]
    assert weights @ scaled == pytest.approx(0.5, abs=4 * float(np.sqrt(weights**2 @ scaled**2)))
