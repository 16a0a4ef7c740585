"""Kernel ridge regression that chooses its kernel and ridge by leave-one-out, in closed form.

With the kernel matrix K (n, n) of the training inputs and G = (K + w I)^-1, the prediction of the
outputs y_B of a block B of samples from all others is off by G_BB^-1 (G y)_B: no regression has to
be repeated. A block is one sample, or all samples of one sensor. One eigendecomposition of K serves
every ridge w.

Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sec. 2.2 and 5.4.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.distance import cdist

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError

Kernel = Callable[[Array, Array], Array]

WIDTHS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Widths of the Gaussian to choose from, as multiples of the median distance of two inputs."""

WEIGHTS = tuple(10.0**k for k in np.arange(-6, 2.5, 0.5))
"""Ridges to choose from, as multiples of the kernel matrix's mean diagonal."""


@dataclass(frozen=True, eq=False)
class KernelRidge:
    """Outputs (n, k) from inputs (n, d), learned from samples of both.

    Attributes:
        kernel: from inputs (n, d) and (m, d) to their kernel (n, m).
        samples: (m, d) the training inputs.
        coefficients: (m, k).
        mean: (k,) of the training outputs.
        error: root mean squared error of the training outputs, each block left out in its turn.
    """

    kernel: Kernel
    samples: Array
    coefficients: Array
    mean: Array
    error: float

    def __call__(self, inputs: Array) -> Array:
        """Outputs (n, k) of `inputs` (n, d)."""
        return np.asarray(self.mean + self.kernel(inputs, self.samples) @ self.coefficients)


def linear(a: Array, b: Array) -> Array:
    """The kernel (n, m) of linear functions with a constant, of inputs (n, d) and (m, d)."""
    return np.asarray(a @ b.T / a.shape[1] + 1.0)


def gaussian(width: float, a: Array, b: Array) -> Array:
    """The Gaussian kernel (n, m) of the given `width`, of inputs (n, d) and (m, d)."""
    return np.asarray(np.exp(cdist(a, b, "sqeuclidean") / (-2 * width**2)))


def gaussians(inputs: Array) -> list[Kernel]:
    """Gaussian kernels of all `WIDTHS` for `inputs` (n, d)."""
    distances = cdist(inputs, inputs)[np.triu_indices(len(inputs), 1)]
    typical = float(np.median(distances)) or 1.0
    return [partial(gaussian, factor * typical) for factor in WIDTHS]


def kernel_ridge(
    inputs: Array,
    outputs: Array,
    kernels: Sequence[Kernel],
    blocks: Sequence[slice] = (),
) -> KernelRidge:
    """The regression of `outputs` (n, k) on `inputs` (n, d) with the least leave-one-out error.

    Args:
        inputs, outputs: the samples.
        kernels: to choose from.
        blocks: samples that are left out together; by default each is alone, and so it is where
            one block holds all, since nothing would be left to learn from.

    Raises:
        InputError: fewer than 3 samples.
    """
    if len(inputs) < 3:
        raise InputError(f"A regression needs at least 3 samples, got {len(inputs)}.")
    mean = outputs.mean(axis=0)
    blocks = blocks if len(blocks) > 1 else ()
    candidates = []
    for kernel in kernels:
        matrix = kernel(inputs, inputs)
        energy, vectors = np.linalg.eigh(matrix)
        rotated = vectors.T @ (outputs - mean)
        for weight in WEIGHTS:
            damped = np.maximum(energy, 0.0) + weight * np.trace(matrix) / len(matrix)
            coefficients = vectors @ (rotated / damped[:, None])
            left_out = coefficients / (vectors**2 @ (1 / damped))[:, None]
            for rows in blocks:
                of_block = vectors[rows] / np.sqrt(damped)
                left_out[rows] = np.linalg.solve(of_block @ of_block.T, coefficients[rows])
            error = float(np.sqrt(np.mean(left_out**2)))
            candidates.append(KernelRidge(kernel, inputs, coefficients, mean, error))
    return min(candidates, key=lambda candidate: candidate.error)
