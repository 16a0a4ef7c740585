"""Nonlinear reconstruction: Gauss-Newton steps through the exact forward model.

Each step linearises the model at the present unknown x_k (see `Linearisation`) and solves

    minimise over x   1/2 |F(x_k) + J_k (x - x_k) - (F(0) + dv)|^2 + prior(x).

Data enter as differences added to what the model predicts for the untouched sensor, so that errors
common to both frames (mesh, electrodes) cancel to first order.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import linalg

from eitbench.methods.classical.linearisation import (
    GAINS,
    ROWS,
    UNKNOWN,
    VARIATION,
    WEIGHTS,
    Linearisation,
    Variable,
    damping,
)
from eitbench.methods.classical.noser import noser_covariance
from eitbench.methods.classical.tv_solver import ANISOTROPY, TVSolver
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.symmetry import asymmetry

# ADMM steps between two linearisations; the solver goes on from where it stood.
TV_ITERATIONS = 30
# Fractions of a full step that the line search tries.
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.125)


@dataclass
class GaussNewton(Method):
    """Base of the nonlinear methods; a subclass solves the linearised problem of a step.

    Attributes:
        weight: of the prior, relative to the data term at the background.
        variable, row_exponent, gain_power: see `Linearisation`.
        steps: number of linearisations.
    """

    weight: float = 1e-3
    variable: Variable = "conductivity"
    row_exponent: float = 0.0
    gain_power: float = 0.0
    steps: int = 5

    def fit(self, problem: Problem) -> None:
        """Linearise at the background, which scales data and prior for every later step."""
        self._problem = problem
        self._linearisation = Linearisation(
            problem, self.variable, self.row_exponent, self.gain_power
        )
        self._compression = self._linearisation.compression()
        self._expected = self._combined(problem.background_voltages)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M)."""
        targets = self._linearisation.data(voltages) @ self._compression.T + self._expected
        return np.concatenate(
            [self._linearisation.images(self._solve(target)[None]) for target in targets]
            or [np.empty((0, *self._problem.mask.shape))]
        )

    def linearised(self, x: Array, target: Array) -> tuple[Array, Array]:
        """J_k (m, P) and the data J_k x_k + target - F(x_k) (m,) at the unknown `x` x_k (P,)."""
        image = self._linearisation.images(x[None])[0]
        voltages, sensitivity = self._problem.model.linearise(image)
        rows = sensitivity[:, self._problem.mask] * self._linearisation.slope(x)
        jacobian = self._combined(rows)
        return jacobian, jacobian @ x + target - self._combined(voltages)

    def _combined(self, values: Array) -> Array:
        """Model voltages or rows (M, ...) as the independent combinations (m, ...) of the data."""
        return self._compression @ self._linearisation.weighted(values)

    @abstractmethod
    def _solve(self, target: Array) -> Array:
        """The unknown (P,) whose modelled voltages, combined, come near `target` (m,)."""


@register("gauss-newton-noser")
@dataclass
class GaussNewtonNoser(GaussNewton):
    """Nonlinear Gauss-Newton with the NOSER prior."""

    source: ClassVar[str] = "Yorkey, Webster and Tompkins, IEEE Trans. Biomed. Eng. 34(11), 1987"
    search: ClassVar = {**GAINS, **UNKNOWN, **WEIGHTS, **ROWS}
    weight: float = 0.03

    def fit(self, problem: Problem) -> None:
        """Linearise at the background, where the prior is taken."""
        super().fit(problem)
        rows = self._compression @ self._linearisation.jacobian
        self._covariance = noser_covariance(rows)
        self._damping = damping((rows * self._covariance) @ rows.T, self.weight)

    def _solve(self, target: Array) -> Array:
        x = np.zeros(len(self._covariance))
        cost = self._cost(x, target)
        for _ in range(self.steps):
            jacobian, data = self.linearised(x, target)
            prior = jacobian * self._covariance
            solved = linalg.solve(prior @ jacobian.T + self._damping, data, assume_a="pos")
            full = np.clip(solved @ prior, *self._linearisation.bounds) - x
            # A full step overshoots where the contrast is strong: shorten it until it pays.
            for length in STEP_LENGTHS:
                shorter = self._cost(x + length * full, target)
                if shorter < cost:
                    x, cost = x + length * full, shorter
                    break
            else:
                break
        return x

    def _cost(self, x: Array, target: Array) -> float:
        """|F(x) - target|^2 / w + x^T C^-1 x, what the steps are to lower."""
        image = self._linearisation.images(x[None])[0]
        misfit = self._combined(self._problem.model.voltages(image)) - target
        return float(misfit @ misfit / self._damping[0, 0] + x @ (x / self._covariance))


@register("gauss-newton-tv")
@dataclass
class GaussNewtonTV(GaussNewton):
    """Nonlinear Gauss-Newton with total variation and bounds."""

    source: ClassVar[str] = "Borsic et al., IEEE Trans. Med. Imaging 29(1), 2010"
    expected_failures: ClassVar = asymmetry(ANISOTROPY)
    search: ClassVar = {**GAINS, **UNKNOWN, **VARIATION, **ROWS}
    steps: int = 6

    def _solve(self, target: Array) -> Array:
        mask, state = self._problem.mask, None
        x = np.zeros(int(mask.sum()))
        for _ in range(self.steps):
            jacobian, data = self.linearised(x, target)
            rows = np.zeros((len(jacobian), *mask.shape))
            rows[:, mask] = jacobian
            solver = TVSolver(rows, self.weight, self._linearisation.bounds)
            state = solver.run(data[None], state or solver.start(1), TV_ITERATIONS)
            x = state.image[0, mask]
        return x
