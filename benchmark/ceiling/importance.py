"""Draws of the part of a posterior that a known phantom lies in, by importance sampling.

Where a sampler has lost the true phantom (`drawing.SURPASSED`), what is likely lies about it. From
there vectors are drawn, weighed exactly, and drawn again about those that weigh most; a weight is
over the mixture of all laws so far (adaptive multiple importance sampling: Cornuet, Marin, Mira and
Robert, Scand. J. Stat. 39(4), 2012). So the weights do not depend on where it began.

The evidence is that of the part which was reached, and rough: it is too small rather than too
large, the more so where the posterior falls into pieces. So `sampler.merged` rather gives these
draws too little weight than too much.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special

from eitbench.benchmark.ceiling.frames import Frame
from eitbench.benchmark.ceiling.models import PhantomModels
from eitbench.benchmark.ceiling.moves import Moves
from eitbench.benchmark.ceiling.sampler import AIMED, CHECKED, FALL, LEAST, Draws, effective
from eitbench.methods.shapes.posterior import ENOUGH, resampled
from eitbench.scenarios.arrays import Array, Index

POPULATION, POPULATIONS, NEAR = 400, 24, 0.1
"""Vectors that are drawn about others, how often at most, and how far from a phantom the first ones
lie, over `parameters.STEP`."""


def draws_about(
    models: PhantomModels, family: Index, vector: Array, frame: Frame, rng: np.random.Generator
) -> Draws:
    """Draws of the part of the posterior that a phantom lies in, given a frame.

    Args:
        models: of the unit that the frame comes from.
        family: (1,) number of the phantom's.
        vector: (1, P) of the phantom, filled up with zeros.
        frame: the frame.
        rng: random numbers.
    """
    prior = models.priors[int(family[0])]
    width, missing = len(prior.parameters.low), vector.shape[1] - len(prior.parameters.low)
    jitter = NEAR * prior.parameters.step * rng.standard_normal((CHECKED, width))
    vectors = vector[:, :width] + jitter
    laws: list[Moves] = []
    drawn, fits = np.zeros((0, width)), np.zeros(0)
    for _ in range(POPULATIONS):
        laws.append(Moves.about(prior, vectors, np.zeros((len(vectors), 1))))
        new, _ = laws[-1].scattered(POPULATION, rng)
        padded = np.pad(new, ((0, 0), (0, missing)))
        exact = models.exact(np.full(len(new), family[0]), padded)
        drawn, fits = np.concatenate([drawn, new]), np.append(fits, frame.log_likelihood(exact))
        log_law = special.logsumexp([law.log_law(drawn) for law in laws], axis=0)
        log_weights = prior.log_density(drawn) + fits - log_law - math.log(POPULATION)
        share, power = effective(log_weights) / CHECKED, 1.0
        if share >= AIMED:
            break
        while effective(power * log_weights) < ENOUGH * CHECKED and power > LEAST:
            power *= FALL
        vectors = drawn[resampled(special.softmax(power * log_weights), CHECKED, rng)]
    evidence = math.log(prior.share) + float(special.logsumexp(log_weights))
    families, drawn = np.full(len(drawn), family[0]), np.pad(drawn, ((0, 0), (0, missing)))
    return Draws(families, drawn, special.softmax(log_weights), fits, share, evidence)
