"""Novelty of frames by two questions: does the image explain the frame, and how strong is it?"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, same_reference
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import averaging

FEWEST = 15
"""Frames below which they say too little of what is usual."""
WHITENED = 2 / 3
"""Part of the frames that the covariance of residuals is of; sizes are those of the others, since
whitened residuals are small on the frames that made the covariance."""
SHRINKAGE = 0.1
"""Part of the covariance of residuals that is replaced by its diagonal: frames are few."""


class FrameNovelty:
    """How unlike the frames of a data set others are, with the images that a method has of them.

    What the image leaves unexplained, d - (F(p) - F(untouched)) with the exact model F, is measured
    by the covariance that it has on the data set, so that errors which are usual there count
    little. A frame is described by the logarithms of the size of that and of its strength |d|; its
    novelty is Mahalanobis' distance of the two from those of the data set. So a frame is novel that
    the image does not explain, or that is weaker or stronger than those known. Values that a fault
    spoils, which methods do without, count as unexplained.

    Source: Lee et al., NeurIPS 31, 2018, 7167 (Mahalanobis' distance of features).
    """

    def __init__(self, problem: Problem, data: Dataset, images: Array, gain_power: float) -> None:
        """Learn from the frames of `data` with `images` (n, H, W) [S/m] of them.

        Args:
            problem: its reference frame is another one afterwards.
            data: at least 15 frames.
            images: see above.
            gain_power: of the gains of measurements that are taken out of frames, see `Problem`.

        Raises:
            InputError: fewer frames.
        """
        if len(data) < FEWEST:
            raise InputError(f"Novelty needs at least {FEWEST} familiar frames, got {len(data)}.")
        self._problem, self._gain_power = problem, gain_power
        self._averaging = averaging(problem.sensor.pattern)
        found = []
        for rows in same_reference(data.references):
            problem.reference = data.references[rows.start]
            found.append(self._described(data.voltages[rows], images[rows]))
        residuals, seen = (np.concatenate(parts) for parts in zip(*found, strict=True))
        first = round(WHITENED * len(residuals))
        covariance = residuals[:first].T @ residuals[:first] / first
        covariance += SHRINKAGE * (np.diag(np.diag(covariance)) - covariance)
        root = linalg.cholesky(covariance, lower=True)
        self._whitening = linalg.solve_triangular(root, np.eye(len(root)), lower=True)
        features = _features(residuals[first:] @ self._whitening.T, seen[first:])
        self._mean = features.mean(axis=0)
        self._precision = linalg.inv(np.cov(features.T))

    def of(self, voltages: Array, images: Array) -> Array:
        """Novelty (n,) of frames (n, M) of one reference frame, with `images` (n, H, W) [S/m]."""
        residuals, seen = self._described(voltages, images)
        apart = _features(residuals @ self._whitening.T, seen) - self._mean
        return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", apart, self._precision, apart)))

    def _described(self, voltages: Array, images: Array) -> tuple[Array, Array]:
        """Residuals (n, K) and differences (n, K) [V/A] of independent measurements."""
        problem = self._problem
        seen = problem.difference(voltages, self._gain_power)
        replaced = problem.difference(voltages) - (voltages - problem.reference) / problem.gain
        inside = np.where(problem.mask, images, problem.background)
        explained = np.array([problem.model.voltages(image) for image in inside])
        explained = explained.reshape(seen.shape)  # of no frame, too
        missing = seen - (explained - problem.background_voltages) - replaced
        return missing @ self._averaging, seen @ self._averaging


def _features(whitened: Array, seen: Array) -> Array:
    """Features (n, 2) of frames by whitened residuals and differences (n, K)."""
    sizes = np.stack([np.linalg.norm(whitened, axis=1), np.linalg.norm(seen, axis=1)], axis=1)
    # A frame that equals its reference has no logarithm.
    return np.asarray(np.log(np.maximum(sizes, 1e-12)))
