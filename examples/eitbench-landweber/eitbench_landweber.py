"""The Landweber iteration: gradient descent on the linearised problem, stopped early."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.methods import Method, Problem, register

Array = NDArray[np.float64]


@register("landweber")
@dataclass
class Landweber(Method):
    """Gradient descent on |J x - dv|^2 from x = 0; stopping early is what regularises it.

    With J = U S V^T and a step t below 2 / s_1^2, n iterations multiply each component of the
    pseudo-inverse by 1 - (1 - t s^2)^n: components of large singular values come first. That
    filter is applied at once, so that a frame costs one product whatever n is.

    Attributes:
        iterations: n.
    """

    source: ClassVar[str] = "Landweber, Amer. J. Math. 73(3), 1951"
    search: ClassVar[Mapping[str, Sequence[object]]] = {
        "iterations": (3, 10, 30, 100, 300, 1000, 3000, 10_000),
    }
    iterations: int = 100

    def fit(self, problem: Problem) -> None:
        """Factor the Jacobian, and filter its pseudo-inverse."""
        self._problem = problem
        jacobian = problem.jacobian[:, problem.mask]
        u, s, vt = np.linalg.svd(jacobian, full_matrices=False)
        seen = s > 1e-10 * s[0]
        u, s, vt = u[:, seen], s[seen], vt[seen]
        # t = 1 / s_1^2; expm1 and log1p keep the digits of small singular values.
        with np.errstate(divide="ignore"):  # the largest one is reached by one step: log(0)
            gain = -np.expm1(self.iterations * np.log1p(-((s / s[0]) ** 2)))
        self._matrix = (u * (gain / s)) @ vt

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        problem = self._problem
        contrast = problem.difference(voltages) @ self._matrix
        images = np.full((len(contrast), *problem.mask.shape), problem.background)
        images[:, problem.mask] += contrast
        low, high = problem.sensor.conductivity_range
        return images.clip(low * problem.background, high * problem.background)
