"""Total variation with bounds, solved by the alternating direction method of multipliers (ADMM).

    minimise over x   1/2 |J x - b|^2 + weight * sum_p |grad x|_p   subject to  lower <= x <= upper

Splitting d = grad x and z = x (Boyd et al. 2011, section 6.4; Goldstein and Osher 2009) leaves

    x = (J^T J + r1 grad^T grad + r2 I)^-1 (J^T b + r1 grad^T (d - u) + r2 (z - w)).

On the full pixel rectangle with zero flux at its rim grad^T grad is diagonal under the cosine
transform, and J has few rows, so the inverse is a diagonal plus a low-rank term (Woodbury): one
small factorisation serves all frames, and a step costs two transforms and two thin products.
Pixels outside a round sensor have no sensitivity; they are filled in and ignored.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.fft import dctn, idctn

from eitbench.methods.classical.linearisation import positive
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.compiling import compiled

ANISOTROPY = (
    "the total variation of forward differences knows one diagonal of the pixels from the other "
    "(Condat, SIAM J. Imaging Sci. 10(3), 2017)"
)
"""Reason why methods that use it are not equivariant, however long they iterate."""

# Penalties relative to the weight of the variation, and over-relaxation. They set the speed of
# convergence only, not the solution.
GRADIENT_PENALTY = 10.0
BOUND_PENALTY = 10.0
RELAXATION = 1.7


@dataclass
class TVState:
    """State of the iteration for n images, to start the next one from. All (n, H, W)."""

    image: Array
    image_dual: Array
    gradient: Array
    gradient_dual: Array


class TVSolver:
    """The minimiser for one Jacobian, factorised once.

    Args:
        jacobian: (m, H, W), scaled so that its largest singular value is about 1.
        weight: weight of the total variation.
        bounds: least and greatest value of x.

    Raises:
        InputError: a weight that is not above 0.
    """

    def __init__(self, jacobian: Array, weight: float, bounds: tuple[float, float]) -> None:
        positive("weight", weight)
        self._shape = height, width = jacobian.shape[1:]
        self._bounds = bounds
        self._r1, self._r2 = GRADIENT_PENALTY * weight, BOUND_PENALTY * weight
        self._threshold = weight / self._r1
        laplacian = np.add.outer(_laplacian_spectrum(height), _laplacian_spectrum(width))
        self._diagonal = 1 / (self._r1 * laplacian + self._r2)
        m = len(jacobian)
        self._rows = dctn(jacobian, axes=(1, 2), norm="ortho").reshape(m, -1)
        scaled = self._rows * self._diagonal.ravel()
        core = linalg.cholesky(np.eye(m) + scaled @ self._rows.T, lower=True)
        # A product with the inverse of the small factor is four times as fast as to solve with it.
        self._low_rank = linalg.solve_triangular(core, np.eye(m), lower=True) @ scaled

    def start(self, n: int) -> TVState:
        """The state of n images at zero."""
        image, gradient = np.zeros((n, *self._shape)), np.zeros((2, n, *self._shape))
        return TVState(image, image.copy(), gradient, gradient.copy())

    def run(self, data: Array, state: TVState, iterations: int) -> TVState:
        """The state `iterations` steps on, for `data` (n, m); its `image` is the solution."""
        n = len(data)
        data_term = (data @ self._rows).reshape(n, *self._shape)
        z, w, d, u = state.image, state.image_dual, state.gradient, state.gradient_dual
        z, w, d, u = z.copy(), w.copy(), d.copy(), u.copy()
        right = np.empty_like(z)
        for _ in range(iterations):
            _right_side(z, w, d, u, self._r1, self._r2, right)
            spectrum = dctn(right, axes=(1, 2), norm="ortho") + data_term
            low_rank = (spectrum.reshape(n, -1) @ self._low_rank.T) @ self._low_rank
            x = idctn(
                spectrum * self._diagonal - low_rank.reshape(spectrum.shape),
                axes=(1, 2),
                norm="ortho",
            )
            _split(x, z, w, d, u, self._threshold, *self._bounds)
        return TVState(z, w, d, u)


def _laplacian_spectrum(n: int) -> Array:
    """Eigenvalues (n,) of the 1-D Laplacian with zero flux, in the cosine transform's order."""
    return np.asarray(2 - 2 * np.cos(np.pi * np.arange(n) / n))


@compiled
def _right_side(z: Array, w: Array, d: Array, u: Array, r1: float, r2: float, right: Array) -> None:
    """right = r1 grad^T (d - u) + r2 (z - w), all (n, H, W) but d and u (2, n, H, W).

    grad takes forward differences, zero across the rim.
    """
    n, height, width = z.shape
    for k in range(n):
        for i in range(height):
            for j in range(width):
                leaving = d[0, k, i, j] - u[0, k, i, j] + d[1, k, i, j] - u[1, k, i, j]
                right[k, i, j] = r2 * (z[k, i, j] - w[k, i, j]) - r1 * leaving
            for j in range(1, width):
                right[k, i, j] += r1 * (d[0, k, i, j - 1] - u[0, k, i, j - 1])
            if i:
                for j in range(width):
                    right[k, i, j] += r1 * (d[1, k, i - 1, j] - u[1, k, i - 1, j])


@compiled
def _split(
    x: Array, z: Array, w: Array, d: Array, u: Array, threshold: float, low: float, high: float
) -> None:
    """Move z, w (n, H, W) and d, u (2, n, H, W) one step on, in place, to x (n, H, W).

    d is the relaxed gradient, its length shortened by `threshold`, z the relaxed image within its
    bounds, and w and u are what that takes away.
    """
    n, height, width = x.shape
    for k in range(n):
        for i in range(height):
            below = min(i + 1, height - 1)
            for j in range(width):
                right = min(j + 1, width - 1)
                across = RELAXATION * (x[k, i, right] - x[k, i, j])
                along = RELAXATION * (x[k, below, j] - x[k, i, j])
                across += (1 - RELAXATION) * d[0, k, i, j] + u[0, k, i, j]
                along += (1 - RELAXATION) * d[1, k, i, j] + u[1, k, i, j]
                length = math.sqrt(across**2 + along**2)
                kept = max(length - threshold, 0.0) / max(length, threshold)
                d[0, k, i, j], d[1, k, i, j] = kept * across, kept * along
                u[0, k, i, j], u[1, k, i, j] = (1 - kept) * across, (1 - kept) * along
                relaxed = RELAXATION * x[k, i, j] + (1 - RELAXATION) * z[k, i, j] + w[k, i, j]
                z[k, i, j] = min(max(relaxed, low), high)
                w[k, i, j] = relaxed - z[k, i, j]
