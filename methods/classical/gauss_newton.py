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
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import independent
from eitbench.scenarios.sensors.symmetry import asymmetry

# ADMM steps between two linearisations; the solver goes on from where it stood.
TV_ITERATIONS = 30
# An image that changes by less than this share of its contrast needs no further linearisation.
# Three are enough for most frames; strong contrasts take more. 45 steps and 0.05 take 1.6 times as
# long, for 0.1 dB at most, up or down (40 validation frames each of clean `paper`, 50 and 30 dB).
STILL = 0.1
# Fractions of a full step that the line search tries.
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.125)


@dataclass
class GaussNewton(Method):
    """Base of the nonlinear methods; a subclass solves the linearised problem of a step.

    Attributes:
        weight: of the prior, relative to the data term at the background.
        variable, row_exponent, gain_power: see `Linearisation`.
        steps: number of linearisations, at most.
    """

    weight: float = 1e-3
    variable: Variable = "conductivity"
    row_exponent: float = 0.0
    gain_power: float = 0.0
    steps: int = 5

    @property
    def negligible(self) -> float:
        """Singular value squared of the data, of 1 at most, below which they are left out."""
        return 1e-12

    def fit(self, problem: Problem) -> None:
        """Linearise at the background, which scales data and prior for every later step.

        Raises:
            InputError: no step, or another impossible parameter.
        """
        if not (isinstance(self.steps, int) and self.steps >= 1):
            raise InputError(
                "A Gauss-Newton method takes a whole number of steps, 1 at least, got "
                f"{self.steps}."
            )
        self._problem = problem
        self._linearisation = Linearisation(
            problem, self.variable, self.row_exponent, self.gain_power
        )
        self._compression = self._linearisation.compression(self.negligible)
        # Of a model, half of the measurements say it all: reciprocity repeats them exactly.
        self._measured, owner, sign = independent(problem.sensor.pattern)
        repeated = np.zeros((len(owner), len(self._measured)))
        repeated[np.arange(len(owner)), owner] = sign
        self._combination = self._compression @ self._linearisation.weighted(repeated)
        self._expected = self._combination @ problem.background_voltages[self._measured]

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M)."""
        targets = self._linearisation.data(voltages) @ self._compression.T + self._expected
        return np.concatenate(
            [self._linearisation.images(self._solve(target)[None]) for target in targets]
            or [np.empty((0, *self._problem.mask.shape))]
        )

    def linearised(self, x: Array, target: Array) -> tuple[Array, Array]:
        """J_k (m, H, W) and the data J_k x_k + target - F(x_k) (m,) at the unknown `x` x_k (P,)."""
        image = self._linearisation.images(x[None])[0]
        voltages, sensitivity = self._problem.model.linearise(image, self._measured)
        unknown, slope = np.zeros(image.shape), np.zeros(image.shape)
        unknown[self._problem.mask] = x
        slope[self._problem.mask] = self._linearisation.slope(x)
        jacobian = self._combination @ sensitivity.reshape(len(sensitivity), -1)
        jacobian *= slope.ravel()
        data = jacobian @ unknown.ravel() + target - self._combination @ voltages[self._measured]
        return jacobian.reshape(-1, *image.shape), data

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
            sensitivity, data = self.linearised(x, target)
            jacobian = sensitivity[:, self._problem.mask]
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
        voltages = self._problem.model.voltages(image)[self._measured]
        misfit = self._combination @ voltages - target
        return float(misfit @ misfit / self._damping[0, 0] + x @ (x / self._covariance))


@register("gauss-newton-tv")
@dataclass
class GaussNewtonTV(GaussNewton):
    """Nonlinear Gauss-Newton with total variation and bounds."""

    source: ClassVar[str] = "Borsic et al., IEEE Trans. Med. Imaging 29(1), 2010"
    expected_failures: ClassVar = asymmetry(ANISOTROPY)
    search: ClassVar = {**GAINS, **UNKNOWN, **VARIATION, **ROWS}
    steps: int = 6

    @property
    def negligible(self) -> float:
        """See `GaussNewton`; the penalties of `TVSolver` are 10,000 times as strong."""
        return 1e-3 * self.weight

    def fit(self, problem: Problem) -> None:
        """Linearise at the background, where every frame's first step is taken."""
        super().fit(problem)
        untouched = np.zeros(int(problem.mask.sum()))
        self._first = self._solver(self.linearised(untouched, self._expected)[0])

    def _solve(self, target: Array) -> Array:
        solver, data = self._first, target - self._expected
        state = solver.start(1)
        for step in range(self.steps):
            if step:
                jacobian, data = self.linearised(state.image[0, self._problem.mask], target)
                solver = self._solver(jacobian)
            before, state = state.image, solver.run(data[None], state, TV_ITERATIONS)
            if step and linalg.norm(state.image - before) < STILL * linalg.norm(state.image):
                break
        return np.asarray(state.image[0, self._problem.mask])

    def _solver(self, jacobian: Array) -> TVSolver:
        return TVSolver(jacobian, self.weight, self._linearisation.bounds)
