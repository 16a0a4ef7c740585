"""Ridge regression from voltages to images: the best linear map that can be learned."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Images = NDArray[np.float32]

WEIGHTS = (1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Regularisations to choose from, relative to the mean variance of the inputs."""


class Ridge(NamedTuple):
    """A linear map (K, P), the weight it was regularised with, and its validation error."""

    matrix: Images
    weight: float
    validation_mse: float


def ridge(inputs: Array, targets: Images, seen_inputs: Array, seen_targets: Images) -> Ridge:
    """The map with the least validation error: (X^T X + w t I)^-1 X^T Y, t = tr(X^T X) / K.

    There is no intercept: the reference frame gives the background.

    Args:
        inputs: X (n, K), standardised differences.
        targets: Y (n, P), contrasts.
        seen_inputs, seen_targets: the same of the validation split, which chooses w.
    """
    energy, vectors = np.linalg.eigh(inputs.T @ inputs)
    rotated = (vectors.T @ inputs.T).astype(np.float32) @ targets
    candidates = []
    for weight in WEIGHTS:
        scale = 1 / (np.maximum(energy, 0) + weight * energy.mean())
        matrix = (vectors * scale).astype(np.float32) @ rotated
        error = seen_inputs.astype(np.float32) @ matrix - seen_targets
        candidates.append(Ridge(matrix, weight, float(np.mean(error**2))))
    return min(candidates, key=lambda candidate: candidate.validation_mse)
