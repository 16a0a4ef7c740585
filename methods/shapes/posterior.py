"""The posterior of the shapes of a family, by adaptive importance sampling about a fit.

For the parameters theta of a family with prior p, images x(theta) and data d = F(x) + noise of an
unknown level, the posterior is

    p(theta | d)  ~  p(theta) |d - F(x(theta))|^-K,

the likelihood of K measurements after the level s has been integrated out with the prior 1/s. The
prior is uniform over ranges and places alike, where the regions lie in the sensor and apart.
(Phantoms are drawn with the place after the sizes, so that large ones are somewhat more likely.)

Samples are drawn from a multivariate t distribution q, weighted by p(theta | d) / q(theta), and q
is fitted to them, again and again (population Monte Carlo, Cappe et al. 2004). It begins as the
Laplace approximation about a fit. Where few samples carry all the weight, as with frames that have
next to no noise, weights are taken to a power below 1 at which enough of them count: q then closes
in on the posterior round by round. If the last round is still tempered, its mean is that of a wider
distribution than the posterior; the evidence is always that of the weights themselves.

K values with equal noise are assumed. Values that were filled in for a dead electrode, or estimated
with gains taken out, are neither independent nor of equal noise: the posterior is then too sharp.

An image of sharp edges jumps where an edge passes the centre of a pixel. That is as the phantoms
are, so that samples are rasterised like them, unless noise hides it. The model is linearised about
the image of q's centre, from which samples differ in pixels along the edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, special

from eitbench.methods.shapes.fit import EDGE, Fit, FrameModel
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.arrays import Array

FREEDOM = 5
"""Degrees of freedom of the t distribution: its tails must be longer than the posterior's."""
ENOUGH = 0.1
"""Effective share of the samples below which weights are tempered."""
LEAST_POWER = 1e-6
"""Of the weights."""
SHRINKING = 0.5
"""Factor of the covariance that q had, where weights are tempered and too few samples count to
replace it."""
SHARP = 0.008
"""Error of the best fit, relative to a frame's differences, below which samples have sharp edges.
A soft edge errs about as much: below, only sharp ones tell shapes apart; above, soft ones, whose
likelihood is smooth, need far fewer samples."""
ROUNDING = 1e-9
"""Error of the model by rounding, relative to a frame's differences: no fit is better."""
HEAVY = 1e-3
"""Samples of a greater weight are checked to lie within the sensor."""


@dataclass(frozen=True, eq=False)
class FamilyPosterior:
    """The posterior within a family.

    Attributes:
        mean: (H, W) the mean image, relative to the background; of the tempered posterior where the
            last round is tempered.
        log_evidence: logarithm of p(d), but for what all families share and for the share of the
            ranges that lies in the sensor; -inf where no sample does.
        error: least |d - F(x)|^2 of a sample [(V/A)^2].
    """

    mean: Array
    log_evidence: float
    error: float


@dataclass(frozen=True, eq=False)
class Sampler:
    """Sampling of posteriors, given one frame.

    Attributes:
        model: the exact model.
        data: (K,) the frame's combinations [V/A].
        samples: that are drawn in a round.
        rounds: at most.
    """

    model: FrameModel
    data: Array
    samples: int
    rounds: int

    def posterior(self, fit: Fit, error: float, rng: np.random.Generator) -> FamilyPosterior:
        """The posterior within the family of a `fit`, where the best fit leaves an `error`."""
        parameters, centre = fit.parameters, fit.vector
        energy = float(self.data @ self.data)
        least = ROUNDING**2 * energy
        variance = max(error, least) / self.model.count
        information = fit.information / np.outer(parameters.step, parameters.step) / variance
        covariance = linalg.inv(information + np.diag(12 / parameters.span**2))
        edge = 0.0 if error < SHARP**2 * energy else EDGE
        log_prior = math.log(parameters.copies) - float(np.log(parameters.span).sum())
        for number in range(self.rounds):
            root = linalg.cholesky((covariance + covariance.T) / 2, lower=True)
            vectors, log_density = _drawn(centre, root, self.samples, rng)
            within = parameters.within(vectors)
            within[0] = True  # the centre, but for rounding
            vectors, log_density = vectors[within], log_density[within]
            images = np.array([parameters.image(vector, edge) for vector in vectors])
            about = self.model.linearised(images[0])
            errors = ((self.data - about.differences(images)) ** 2).sum(axis=1)
            log_likelihood = -self.model.count / 2 * np.log(errors.clip(min=least))
            log_weights = log_prior + log_likelihood - log_density
            weights, power = _possible(log_weights, vectors, parameters, ENOUGH * self.samples)
            mean = np.tensordot(weights, images, axes=1)
            evidence = float(special.logsumexp(log_weights)) - math.log(self.samples)
            if power == 1 and number:
                break
            centre, found = _moments(vectors, weights)
            # The samples that count, beside as many as there are parameters.
            effective = 1 / float(weights @ weights)
            share = effective / (effective + len(centre))
            covariance *= (1 - share) * (1.0 if power == 1 else SHRINKING)
            covariance += share * found + np.diag((1e-4 * parameters.step) ** 2)
        return FamilyPosterior(mean, evidence, float(errors.min()))


def _drawn(centre: Array, root: Array, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Vectors (n, P) of a t distribution, the first at its centre, and their log density (n,)."""
    size = len(centre)
    normal = rng.standard_normal((count, size))
    normal /= np.sqrt(rng.chisquare(FREEDOM, count) / FREEDOM)[:, None]
    normal[0] = 0.0
    constant = (
        special.gammaln((FREEDOM + size) / 2)
        - special.gammaln(FREEDOM / 2)
        - size / 2 * math.log(FREEDOM * math.pi)
        - np.log(np.diag(root)).sum()
    )
    distance = (normal**2).sum(axis=1) / FREEDOM
    return centre + normal @ root.T, constant - (FREEDOM + size) / 2 * np.log1p(distance)


def _moments(vectors: Array, weights: Array) -> tuple[Array, Array]:
    """Mean (P,) and covariance (P, P) of weighted vectors (n, P)."""
    mean = weights @ vectors
    spread = vectors - mean
    return mean, (spread * weights[:, None]).T @ spread


def _possible(
    log_weights: Array, vectors: Array, parameters: Parameters, enough: float
) -> tuple[Array, float]:
    """Weights (n,) and their power, see `_tempered`, where impossible vectors have none.

    `log_weights` of those that are found impossible become -inf in place. Only those that matter
    are looked at.
    """
    while True:
        weights, power = _tempered(log_weights, enough)
        heavy = np.flatnonzero(weights > HEAVY)
        outside = heavy[~parameters.possible(vectors[heavy])]
        if not len(outside):
            return weights, power
        log_weights[outside] = -np.inf
        if not np.isfinite(log_weights).any():
            return weights, power


def _tempered(log_weights: Array, enough: float) -> tuple[Array, float]:
    """Weights (n,) to a power of at most 1 at which at least `enough` samples count."""
    shifted = log_weights - log_weights.max()

    def weights(power: float) -> Array:
        found = np.exp(power * shifted)
        return np.asarray(found / found.sum())

    def surplus(power: float) -> float:
        found = weights(power)
        return 1 / float(found @ found) - enough

    if surplus(1.0) >= 0:
        return weights(1.0), 1.0
    if surplus(LEAST_POWER) <= 0:
        return weights(LEAST_POWER), LEAST_POWER
    power = float(optimize.brentq(surplus, LEAST_POWER, 1.0, xtol=1e-6, rtol=1e-3))
    return weights(power), power
