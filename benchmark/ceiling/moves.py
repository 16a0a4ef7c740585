"""Moves of particles within their family, by an emulator that takes no solution.

Predictions are nearly a quadratic of the coordinates where particles are close to each other. So a
chain of Metropolis steps asks this `Emulator` alone; where the chain ends is then accepted or not
by the model (`sampler`).

Two kinds of proposals make two samplers: `walk` takes normal steps with the covariance of a
family's particles, `differences` steps along the difference of two of them (ter Braak, Statistics
and Computing 16, 2006).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy import linalg, special
from scipy.spatial import distance

from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.scenarios.arrays import Array, Index

Proposals = Literal["walk", "differences"]
PROPOSALS: tuple[Proposals, ...] = ("walk", "differences")

LONGEST = 2.4
"""Length of steps, in standard deviations of a family over the root of the number of parameters."""
BESIDE = 0.1
"""Part of a normal step that is added to one along a difference."""
FREEDOM = 5
"""Degrees of freedom of the distributions that vectors are scattered by: their tails are long."""
RIDGE = 1e-3
"""Added to the squares of each term of an emulator: particles may be alike."""


@dataclass(frozen=True, eq=False)
class Emulator:
    """Predictions as a quadratic of coordinates.

    Attributes:
        mean: (P,) of the coordinates that it was fitted to.
        scale: (P,) their standard deviations.
        coefficients: (T, K) of the terms.
    """

    mean: Array
    scale: Array
    coefficients: Array

    @classmethod
    def fitted(cls, coordinates: Array, predictions: Array) -> Emulator:
        """The one that is nearest to predictions (n, K) at coordinates (n, P)."""
        mean, scale = coordinates.mean(axis=0), coordinates.std(axis=0) + 1e-12
        terms = _terms((coordinates - mean) / scale)
        squares = terms.T @ terms + RIDGE * np.eye(terms.shape[1])
        return cls(mean, scale, linalg.solve(squares, terms.T @ predictions, assume_a="pos"))

    def __call__(self, coordinates: Array) -> Array:
        """Predictions (n, K) at coordinates (n, P)."""
        return np.asarray(_terms((coordinates - self.mean) / self.scale) @ self.coefficients)


def _terms(away: Array) -> Array:
    """One, the coordinates (n, P), and the products of two of them: (n, T)."""
    one, other = np.triu_indices(away.shape[1])
    products = away[:, one] * away[:, other]
    return np.concatenate([np.ones((len(away), 1)), away, products], axis=1)


class State(NamedTuple):
    """Where particles of a family are.

    Attributes:
        vectors: (n, P) parameters.
        coordinates: (n, P).
        log_prior: (n,) logarithm of the prior's density over coordinates.
        log_likelihood: (n,) of the emulator's predictions.
    """

    vectors: Array
    coordinates: Array
    log_prior: Array
    log_likelihood: Array

    def where(self, chosen: Index, other: State) -> State:
        """These states, but for the `chosen`, which `other` has."""
        found = State._make(values.copy() for values in self)
        for values, new in zip(found, other, strict=True):
            values[chosen] = new
        return found


@dataclass(frozen=True, eq=False)
class Moves:
    """Metropolis steps by an emulator, about the particles that it was fitted to.

    Attributes:
        prior: of the family.
        centre: (P,) that vectors stand about, see `FamilyPrior`.
        coordinates: (n, P) of the particles.
        root: (P, P) of the covariance of these.
        emulator: of the predictions.
    """

    prior: FamilyPrior
    centre: Array
    coordinates: Array
    root: Array
    emulator: Emulator

    @classmethod
    def about(cls, prior: FamilyPrior, vectors: Array, predictions: Array) -> Moves:
        """The moves about particles with vectors (n, P) and predictions (n, K)."""
        centre = prior.centre(vectors)
        coordinates, _ = prior.parameters.straightened(prior.arranged(vectors, centre))
        count, width = coordinates.shape
        away = coordinates - coordinates.mean(axis=0)
        deviations = away.std(axis=0) + 1e-12
        away /= deviations
        # The fewer particles there are, the less their correlation is believed.
        believed = count / (count + width)
        correlation = believed * away.T @ away / count + (1 - believed + 1e-9) * np.eye(width)
        root = deviations[:, None] * linalg.cholesky(correlation, lower=True)
        return cls(prior, centre, coordinates, root, Emulator.fitted(coordinates, predictions))

    def state(self, vectors: Array, log_likelihood: Callable[[Array], Array]) -> State:
        """The state of particles with vectors (n, P); `log_likelihood` is of predictions."""
        arranged = self.prior.arranged(vectors, self.centre)
        coordinates, volume = self.prior.parameters.straightened(arranged)
        log_prior = self.prior.log_density(arranged) + volume
        return State(arranged, coordinates, log_prior, log_likelihood(self.emulator(coordinates)))

    def moved(
        self,
        now: State,
        stride: float,
        log_likelihood: Callable[[Array], Array],
        proposals: Proposals,
        rng: np.random.Generator,
    ) -> tuple[State, float]:
        """The state after one step of all particles, and the share of them that took it.

        Args:
            now: the state before.
            stride: least length of a step, over the longest.
            log_likelihood: of predictions (n, K).
            proposals: see the module.
            rng: random numbers.
        """
        parameters, count = self.prior.parameters, len(now.vectors)
        step = stride ** rng.random((count, 1)) * self._steps(count, proposals, rng)
        vectors = self.prior.unwrapped(parameters.bent(now.coordinates + step), self.centre)
        tried = np.flatnonzero(self.prior.standing(vectors, self.centre))
        ahead = self.state(vectors[tried], log_likelihood)
        gain = ahead.log_prior - now.log_prior[tried]
        gain += ahead.log_likelihood - now.log_likelihood[tried]
        taken = np.log(rng.random(len(tried))) < gain
        taken[taken] = self.prior.fitting(ahead.vectors[taken])
        after = now.where(tried[taken], State._make(values[taken] for values in ahead))
        return after, float(taken.sum() / count)

    def scattered(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Vectors (m, P) about the particles, and the logarithms (m,) of the prior over their law.

        That law is a mixture of Student's distributions, one about each particle (West, J. R. Stat.
        Soc. B 55(2), 1993), as wide as Silverman's rule for normal kernels has it. Of `count`
        vectors, those which stand for phantoms that fit into the sensor are returned.
        """
        number, width = self.coordinates.shape
        tails = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (count, 1)))
        steps = tails * rng.standard_normal((count, width)) @ self._kernel.T
        coordinates = self.coordinates[rng.integers(number, size=count)] + steps
        vectors = self.prior.parameters.bent(coordinates)
        # The same phantom a turn further on would count again.
        kept = np.isclose(vectors, self.prior.unwrapped(vectors, self.centre)).all(axis=1)
        kept &= self.prior.standing(vectors, self.centre)
        kept[kept] = self.prior.fitting(vectors[kept])
        vectors = vectors[kept]
        return vectors, self.prior.log_density(vectors) - self.log_law(vectors)

    def log_law(self, vectors: Array) -> Array:
        """Logarithms (n,) of the density over vectors that `scattered` draws phantoms by."""
        arranged = self.prior.arranged(vectors, self.centre)
        coordinates, volume = self.prior.parameters.straightened(arranged)
        number, width = self.coordinates.shape
        white, about = (
            linalg.solve_triangular(self._kernel, of.T, lower=True).T
            for of in (coordinates, self.coordinates)
        )
        squares = distance.cdist(white, about, "sqeuclidean")
        kernels = -(FREEDOM + width) / 2 * np.log1p(squares / FREEDOM)
        constant = special.gammaln((FREEDOM + width) / 2) - special.gammaln(FREEDOM / 2)
        constant -= width / 2 * math.log(FREEDOM * math.pi)
        constant -= np.log(np.diag(self._kernel)).sum()
        return np.asarray(special.logsumexp(kernels, axis=1) - math.log(number) + constant - volume)

    @property
    def _kernel(self) -> Array:
        """Root (P, P) of the covariance of the law about each particle."""
        number, width = self.coordinates.shape
        return np.asarray((4 / (number * (width + 2))) ** (1 / (width + 4)) * self.root)

    def _steps(self, count: int, proposals: Proposals, rng: np.random.Generator) -> Array:
        """Steps (count, P) of the longest length."""
        width = len(self.centre)
        steps = rng.standard_normal((count, width)) @ self.root.T
        if proposals == "differences":
            one, other = rng.integers(len(self.coordinates), size=(2, count))
            along = (self.coordinates[one] - self.coordinates[other]) / math.sqrt(2)
            steps = along + BESIDE * steps
        return np.asarray(LONGEST / math.sqrt(width) * steps)
