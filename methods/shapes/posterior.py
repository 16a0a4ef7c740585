"""The posterior of the shapes of a family, by sequential Monte Carlo about a fit.

For the parameters theta of a family with prior p, images x(theta) and data d = F(x) + noise of an
unknown level, the posterior is

    p(theta | d)  ~  p(theta) L(theta),    L(theta) = |d - F(x(theta))|^-K,

the likelihood of K measurements after the level s has been integrated out with the prior 1/s. The
prior is uniform over ranges and places alike, where the regions lie in the sensor and apart.
(Phantoms are drawn with the place after the sizes, so that large ones are somewhat more likely.)
It is not divided by the share of places and sizes that fit, so that families of which more fit are
thought likelier than they are.

Particles are drawn from a multivariate t distribution q, the Laplace approximation about a fit with
longer tails, and taken to the posterior through the distributions

    q^(1 - b) (p L)^b,    0 <= b <= 1

(annealed sequential Monte Carlo: Del Moral, Doucet and Jasra 2006, section 3.3). A step raises b by
as much as leaves `ENOUGH` of the particles effective, draws them anew by their weights, and moves
each by a few steps of Metropolis with the covariance of all. The product of the mean weights is the
evidence p(d) of the family. It is an estimate: particles are few, and the linear models below
change from step to step.

K values with equal noise are assumed. Values that were filled in for a dead electrode, or estimated
with gains taken out, are neither independent nor of equal noise: the posterior is then too sharp,
and the estimate of the noise (`FrameModel.noise`) is not of it.

Images have sharp edges, as phantoms have. The model is linearised in every step about the images of
a few particles (`LocalModels`), from which the others differ in pixels along the edges. A frame
without noise is explained by a single set of pixels, and the steps close in on it; where they end
elsewhere, particles are far from explaining the frame, and nothing but their error tells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize, special

from eitbench.methods.shapes.fit import Fit, FrameModel, LinearisedModel
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.arrays import Array, Index, Mask

FREEDOM = 5
"""Degrees of freedom of the t distribution: its tails must be longer than the posterior's."""
ENOUGH = 0.5
"""Effective share of the particles that a step leaves."""
MOVES = 4
"""Of every particle in a step."""
ACCEPTED = 0.25
"""Share of moves that is aimed at (Roberts, Gelman and Gilks 1997)."""
ALONG = 2
"""Vectors about which the model is linearised, beside the likeliest: the posterior may be long."""
TINY = 1e-3
"""Part of a standard deviation by which coordinates are differentiated."""
ROUNDING = 1e-9
"""Error of the model by rounding, relative to a frame's differences: no shape is better."""


@dataclass(frozen=True, eq=False)
class FamilyPosterior:
    """The posterior within a family.

    Attributes:
        parameters: of the family.
        images: (n, H, W) of the particles, relative to the background.
        log_evidence: logarithm of p(d), but for what all families share; of a lower bound where
            `power` is below 1, -inf where no particle lies in the sensor.
        error: least |d - F(x)|^2 of a particle [(V/A)^2], by the nearest linear model.
        power: b of the last step, 1 for the posterior.
    """

    parameters: Parameters
    images: Array
    log_evidence: float
    error: float
    power: float


@dataclass(frozen=True, eq=False)
class Sampler:
    """Sampling of posteriors, given one frame.

    Attributes:
        model: the exact model.
        data: (K,) the frame's combinations [V/A].
        particles: their number.
        steps: at most.
    """

    model: FrameModel
    data: Array
    particles: int
    steps: int

    def posterior(self, fit: Fit, width: float, rng: np.random.Generator) -> FamilyPosterior:
        """The posterior within the family of a `fit`.

        Particles begin where shapes leave about `width` [(V/A)^2] more than the fit does, summed
        over the K values.
        """
        parameters = fit.parameters
        start = self._start(fit, width)
        vectors = parameters.bent(start.draw(self.particles, rng))
        vectors = vectors[parameters.possible(vectors)]
        if len(vectors) < 2:
            image = parameters.image(fit.vector)
            return FamilyPosterior(parameters, image[None], -math.inf, math.inf, 0.0)
        evidence = math.log(len(vectors) / self.particles)
        best, power, stride = vectors[0], 0.0, 1.0
        longest = 2.4 / math.sqrt(len(fit.vector))
        for _ in range(self.steps):
            about = LocalModels.about(self.model, parameters, best, vectors)
            cloud = self._cloud(about, start, vectors)
            raised = rise(cloud.target - cloud.density, 1 - power, ENOUGH * len(vectors))
            power += raised
            log_weights = raised * (cloud.target - cloud.density)
            evidence += float(special.logsumexp(log_weights)) - math.log(len(vectors))
            spread = _spread(cloud.straight, log_weights)
            chosen = resampled(special.softmax(log_weights), self.particles, rng)
            cloud = cloud.take(chosen)
            for _ in range(MOVES):
                lengths = longest * stride ** rng.random((self.particles, 1))
                steps = lengths * rng.standard_normal(cloud.straight.shape) @ spread.T
                moved = parameters.bent(cloud.straight + steps)
                within = parameters.within(moved)
                moved[~within] = cloud.vectors[~within]
                other = self._cloud(about, start, moved)
                gain = power * (other.target - cloud.target)
                gain += (1 - power) * (other.density - cloud.density)
                accepted = within & (np.log(rng.random(self.particles)) < gain)
                accepted[accepted] = parameters.possible(moved[accepted])
                cloud = cloud.where(accepted, other)
                stride = min(stride * math.exp(accepted.mean() - ACCEPTED), 1.0)
            vectors = cloud.vectors
            best = vectors[np.argmax(cloud.target)]
            if power == 1:
                break
        # Jensen's inequality gives what steps that were not taken add at least.
        evidence += (1 - power) * float((cloud.target - cloud.density).mean())
        images = parameters.images(vectors)
        errors = about.errors(self.data, vectors, images)
        return FamilyPosterior(parameters, images, evidence, float(errors.min()), power)

    def _start(self, fit: Fit, width: float) -> Student:
        """The Laplace approximation, in coordinates, for noise of `width` [(V/A)^2] in all."""
        parameters, step = fit.parameters, fit.parameters.step
        information = fit.information / np.outer(step, step) * self.model.count / width
        root = linalg.cholesky(
            linalg.inv(information + np.diag(12 / parameters.span**2)), lower=True
        )
        ends = parameters.straightened(fit.vector + np.concatenate([[0 * step], TINY * root.T]))[0]
        # A coordinate depends on no later value of the vector: the root stays triangular.
        return Student(ends[0], (ends[1:] - ends[0]).T / TINY)

    def _cloud(self, about: LocalModels, start: Student, vectors: Array) -> Cloud:
        """Vectors with their densities over coordinates: of the posterior, and of the start."""
        parameters = about.parameters
        least = ROUNDING**2 * float(self.data @ self.data)
        errors = about.errors(self.data, vectors, parameters.images(vectors))
        straight, log_volume = parameters.straightened(vectors)
        log_prior = math.log(parameters.copies) - float(np.log(parameters.span).sum())
        log_likelihood = -self.model.count / 2 * np.log(errors.clip(min=least))
        target = log_prior + log_volume + log_likelihood
        return Cloud(vectors, straight, target, start.log_density(straight))


class Cloud(NamedTuple):
    """Particles.

    Attributes:
        vectors, straight: (n, P) parameters, and their coordinates.
        target, density: (n,) logarithms of the densities over coordinates: of the posterior but for
            a factor, and of the distribution that particles started from.
    """

    vectors: Array
    straight: Array
    target: Array
    density: Array

    def take(self, chosen: Index) -> Cloud:
        """The particles of these numbers."""
        return Cloud(*(values[chosen] for values in self))

    def where(self, chosen: Mask, other: Cloud) -> Cloud:
        """These particles, or those of `other` where `chosen` (n,) is true."""
        pairs = zip(other, self, strict=True)
        return Cloud(*(np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs))


@dataclass(frozen=True, eq=False)
class LocalModels:
    """The exact model to first order about a few vectors, each for those that are nearest to it.

    Attributes:
        parameters: what vectors mean.
        centres: (C, P), divided by `Parameters.step`.
        models: at each centre.
    """

    parameters: Parameters
    centres: Array
    models: list[LinearisedModel]

    @classmethod
    def about(
        cls, model: FrameModel, parameters: Parameters, best: Array, vectors: Array
    ) -> LocalModels:
        """Models about the `best` of the vectors (n, P), and along their longest axis."""
        scaled = vectors / parameters.step
        along = scaled @ linalg.svd(scaled - scaled.mean(axis=0), full_matrices=False)[2][0]
        order = np.argsort(along)
        chosen = order[((np.arange(ALONG) + 0.5) / ALONG * len(order)).astype(int)]
        centres = np.concatenate([best[None], vectors[chosen]])
        models = [model.linearised(parameters.image(centre)) for centre in centres]
        return cls(parameters, centres / parameters.step, models)

    def errors(self, data: Array, vectors: Array, images: Array) -> Array:
        """|data - F(x)|^2 (n,) [(V/A)^2] of vectors (n, P) and their images (n, H, W)."""
        distance = ((vectors / self.parameters.step)[:, None] - self.centres) ** 2
        nearest = distance.sum(axis=2).argmin(axis=1)
        errors = np.empty(len(vectors))
        for k, model in enumerate(self.models):
            if not (of := nearest == k).any():
                continue
            errors[of] = ((data - model.differences(images[of])) ** 2).sum(axis=1)
        return errors


@dataclass(frozen=True, eq=False)
class Student:
    """A multivariate t distribution with `FREEDOM` degrees of freedom.

    Attributes:
        centre: (P,).
        root: (P, P) lower triangular, a root of the scale matrix.
    """

    centre: Array
    root: Array

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Vectors (count, P), the first at the centre."""
        normal = rng.standard_normal((count, len(self.centre)))
        normal /= np.sqrt(rng.chisquare(FREEDOM, count) / FREEDOM)[:, None]
        normal[0] = 0.0
        return np.asarray(self.centre + normal @ self.root.T)

    def log_density(self, vectors: Array) -> Array:
        """Logarithm of the density (n,) at vectors (n, P)."""
        size = len(self.centre)
        whitened = linalg.solve_triangular(self.root, (vectors - self.centre).T, lower=True)
        constant = (
            special.gammaln((FREEDOM + size) / 2)
            - special.gammaln(FREEDOM / 2)
            - size / 2 * math.log(FREEDOM * math.pi)
            - np.log(np.diag(self.root)).sum()
        )
        distance = (whitened**2).sum(axis=0) / FREEDOM
        return np.asarray(constant - (FREEDOM + size) / 2 * np.log1p(distance))


def _spread(straight: Array, log_weights: Array) -> Array:
    """A root (P, P), lower triangular, of the covariance of weighted coordinates (n, P)."""
    weights = special.softmax(log_weights)
    away = straight - weights @ straight
    # Of coordinates in units of their deviations, and a little more, that there is a root.
    deviations = np.sqrt(weights @ away**2) + 1e-12
    away /= deviations
    correlation = (away * weights[:, None]).T @ away + 1e-9 * np.eye(len(deviations))
    return np.asarray(deviations[:, None] * linalg.cholesky(correlation, lower=True))


def resampled(weights: Array, count: int, rng: np.random.Generator) -> Index:
    """Numbers (count,) of particles, each as often as its weight says (systematic resampling)."""
    return np.searchsorted(np.cumsum(weights), (rng.random() + np.arange(count)) / count).clip(
        max=len(weights) - 1
    )


def rise(log_ratio: Array, most: float, enough: float) -> float:
    """The largest power, at most `most`, of ratios (n,) as weights that leaves `enough` effective.

    `log_ratio` (n,) are their logarithms.
    """
    shifted = log_ratio - log_ratio.max()

    def surplus(power: float) -> float:
        weights = np.exp(power * shifted)
        return float(weights.sum() ** 2 / (weights @ weights)) - enough

    if surplus(most) >= 0:
        return most
    return float(optimize.brentq(surplus, 0.0, most, rtol=1e-3))
