"""Total variation with bounds, solved by the alternating direction method of multipliers (ADMM).

    minimise over x   1/2 |J x - b|^2 + weight * sum_p |grad x|_p   subject to  lower <= x <= upper

Splitting d = grad x and z = x (Boyd et al. 2011, section 6.4; Goldstein and Osher 2009) leaves

    x = (J^T J + r1 grad^T grad + r2 I)^-1 (J^T b + r1 grad^T (d - u) + r2 (z - w)).

On the full pixel rectangle with zero flux at its rim grad^T grad is diagonal under the cosine
transform, and J has few rows, so the inverse is a diagonal plus a low-rank term (Woodbury): one
small factorisation serves all frames, and a step costs two transforms and two thin products.
Pixels outside a round sensor have no sensitivity; they are filled in and ignored.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.fft import dctn, idctn

from eitbench.scenarios.arrays import Array

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
    """

    def __init__(self, jacobian: Array, weight: float, bounds: tuple[float, float]) -> None:
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
        self._low_rank = linalg.solve_triangular(core, scaled, lower=True)

    def start(self, n: int) -> TVState:
        """The state of n images at zero."""
        image, gradient = np.zeros((n, *self._shape)), np.zeros((2, n, *self._shape))
        return TVState(image, image.copy(), gradient, gradient.copy())

    def run(self, data: Array, state: TVState, iterations: int) -> TVState:
        """The state `iterations` steps on, for `data` (n, m); its `image` is the solution."""
        n = len(data)
        data_term = (data @ self._rows).reshape(n, *self._shape)
        z, w, d, u = state.image, state.image_dual, state.gradient, state.gradient_dual
        for _ in range(iterations):
            right = self._r1 * _gradient_transposed(d - u) + self._r2 * (z - w)
            spectrum = dctn(right, axes=(1, 2), norm="ortho") + data_term
            low_rank = (spectrum.reshape(n, -1) @ self._low_rank.T) @ self._low_rank
            x = idctn(
                spectrum * self._diagonal - low_rank.reshape(spectrum.shape),
                axes=(1, 2),
                norm="ortho",
            )
            relaxed_gradient = RELAXATION * _gradient(x) + (1 - RELAXATION) * d + u
            relaxed_image = RELAXATION * x + (1 - RELAXATION) * z + w
            length = np.sqrt(np.sum(relaxed_gradient**2, axis=0))
            d = relaxed_gradient * (
                np.maximum(length - self._threshold, 0) / np.maximum(length, self._threshold)
            )
            u = relaxed_gradient - d
            z = np.clip(relaxed_image, *self._bounds)
            w = relaxed_image - z
        return TVState(z, w, d, u)


def _laplacian_spectrum(n: int) -> Array:
    """Eigenvalues (n,) of the 1-D Laplacian with zero flux, in the cosine transform's order."""
    return np.asarray(2 - 2 * np.cos(np.pi * np.arange(n) / n))


def _gradient(x: Array) -> Array:
    """Forward differences (2, n, H, W) of x (n, H, W), zero across the rim."""
    gradient = np.zeros((2, *x.shape))
    np.subtract(x[..., 1:], x[..., :-1], out=gradient[0, ..., :-1])
    np.subtract(x[..., 1:, :], x[..., :-1, :], out=gradient[1, ..., :-1, :])
    return gradient


def _gradient_transposed(p: Array) -> Array:
    """The transpose of `_gradient`: (2, n, H, W) to (n, H, W)."""
    total = np.zeros(p.shape[1:])
    total[..., :-1] -= p[0, ..., :-1]
    total[..., 1:] += p[0, ..., :-1]
    total[..., :-1, :] -= p[1, ..., :-1, :]
    total[..., 1:, :] += p[1, ..., :-1, :]
    return total
