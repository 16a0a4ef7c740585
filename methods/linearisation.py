"""The linearised problem that the classical methods share: J x = dv on the sensor's pixels."""

import numpy as np
from numpy.typing import NDArray

from eitbench.methods.problem import Problem

Array = NDArray[np.float64]

# Conductivity is positive: no estimate falls below this fraction of the background.
LOWEST = 0.05


class Linearisation:
    """Rows of the Jacobian and of the data under one weighting, and images made from contrasts.

    Rows are divided by their norm to the power `row_exponent`: 0 trusts every volt alike (white
    noise, as on simulated boards), 1 trusts every measurement alike.

    Attributes:
        jacobian: (M, P) weighted rows on the P pixels inside the sensor.
        bounds: least and greatest contrast [S/m].
    """

    def __init__(self, problem: Problem, row_exponent: float, upper: float | None) -> None:
        self._problem = problem
        rows = problem.jacobian[:, problem.mask]
        norms = np.linalg.norm(rows, axis=1)
        floor = 1e-6 * norms.max()  # a row that sees nothing must not be blown up
        self._weights = (np.maximum(norms, floor) / norms.max()) ** -row_exponent
        self.jacobian: Array = self._weights[:, None] * rows
        background = problem.background
        self.bounds = (
            (LOWEST - 1) * background,
            np.inf if upper is None else (upper - 1) * background,
        )

    def data(self, voltages: Array) -> Array:
        """Weighted differences (n, M) from frames (n, M)."""
        return np.asarray(self._problem.difference(voltages) * self._weights)

    def weighted(self, values: Array) -> Array:
        """Model voltages or rows (M, ...) under the same weighting."""
        return np.asarray((values.T * self._weights).T)

    def compression(self) -> Array:
        """(k, M) combinations of weighted measurements that carry all of the signal.

        Measurements repeat one another by reciprocity; the combinations are independent, keep the
        least-squares problem as it is, and scale the Jacobian's largest singular value to 1.
        """
        energy, vectors = np.linalg.eigh(self.jacobian @ self.jacobian.T)
        kept = energy > 1e-12 * energy[-1]
        return np.asarray(vectors[:, kept].T / np.sqrt(energy[-1]))

    def images(self, contrast: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from contrasts (n, P), kept within the bounds."""
        mask, background = self._problem.mask, self._problem.background
        images = np.full((len(contrast), *mask.shape), background)
        images[:, mask] += np.clip(contrast, *self.bounds)
        return images


def damping(gram: Array, weight: float) -> Array:
    """weight * mean(diag(gram)) * identity: a regularisation that does not depend on units."""
    return np.asarray(weight * np.trace(gram) / len(gram) * np.eye(len(gram)))
