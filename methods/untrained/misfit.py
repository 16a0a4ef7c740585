"""Misfit of an image to a frame, in units of the errors that are expected of the data."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy import linalg
from torch import Tensor

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.patterns import averaging, independent

if TYPE_CHECKING:
    from eitbench.methods.operator import Operator
    from eitbench.methods.problem import Problem


CONTRAST = 0.2
"""Standard deviation of a pixel's contrast that is expected, as a fraction of the background."""

MESH_ERROR = 0.007
"""Error of the exact model, as a fraction of a frame's differences.

Between the mesh that methods invert with and one twice as fine it is 0.003 to 0.011 (the first 12
validation frames of `noise-clean`).
"""

FAINTEST = 1e-3
"""Differences are taken to be no weaker than this fraction of what `CONTRAST` would cause."""


class Misfit:
    """The squared error of an operator's voltages, weighted by what is expected of the data.

    For K independent differences d [V/A] (`patterns.averaging`) it is

        1/K (p - d)^T C^-1 (p - d),    p = F(sigma) - F(background),    C = c^2 J J^T + E,

    where C is the covariance of d if contrasts were white of standard deviation c, and the errors'
    variances are the diagonal E. Where d is dominated by errors this is the usual weighted sum of
    squares; where it is not, combinations of measurements that respond weakly to conductivity count
    as much as those that respond strongly, and a gradient step in it resembles a Gauss-Newton step.
    (Fitted to clean validation frames, networks came as far in 50 steps as in 400 without it.)

    E is the noise, which shows in the pairs of measurements that reciprocity makes equal, and the
    error of the model, which does not: that of the mesh and that of F against the exact model, both
    in proportion to the differences. A pattern without such pairs has no known noise.
    """

    def __init__(self, problem: Problem, operator: Operator) -> None:
        self._problem, self._operator = problem, operator
        self._precision = getattr(torch, operator.precision)
        pattern = problem.sensor.pattern
        self._averaging = averaging(pattern)
        _, self._owner, self._sign = independent(pattern)
        rows = self._averaging.T @ problem.jacobian[:, problem.mask] * problem.background
        self._expected = CONTRAST**2 * rows @ rows.T
        untouched = torch.from_numpy(problem.model.background.copy())[None].to(self._precision)
        with torch.no_grad():
            self._untouched = operator.voltages(untouched)
        self._model_error = math.hypot(MESH_ERROR, self._operator_error())

    def predicted(self, sigma: Tensor) -> Tensor:
        """The differences p (n, M) [V/A] of images (n, H, W) [S/m].

        The exact operator rounds an image on its own otherwise than in a batch, which a fit of many
        steps magnifies: it is given twice, so that a frame has the same fit whatever is beside it.
        """
        batch = sigma.to(self._precision).expand(max(len(sigma), 2), -1, -1)
        return (self._operator.voltages(batch) - self._untouched)[: len(sigma)]

    def of(self, difference: Array) -> Callable[[Tensor], Tensor]:
        """The misfit () of predicted differences p (M,) to the `difference` (M,) of one frame."""
        d = torch.from_numpy(difference @ self._averaging)
        covariance = self._expected + np.diag(self._error_variances(difference))
        root = linalg.cholesky(covariance, lower=True)
        whitening = torch.from_numpy(linalg.solve_triangular(root, np.eye(len(root)), lower=True))
        combined = torch.from_numpy(self._averaging)

        def misfit(predicted: Tensor) -> Tensor:
            return (whitening @ (predicted.double() @ combined - d)).square().mean()

        return misfit

    def _error_variances(self, difference: Array) -> Array:
        """(K,) variances of the errors of the independent values of `difference` (M,)."""
        repetitions = np.bincount(self._owner)
        means = difference @ self._averaging
        repeated = len(difference) - len(means)
        scatter = difference - means[self._owner] * self._sign
        noise = float(scatter @ scatter) / repeated if repeated else 0.0
        faintest = FAINTEST**2 * np.trace(self._expected) / len(means)
        strength = max(float(means @ means) / len(means), faintest)
        return np.asarray(noise / repetitions + self._model_error**2 * strength)

    def _operator_error(self) -> float:
        """||F - exact|| / ||exact|| of the differences that 16 touches make."""
        problem = self._problem
        height, width = problem.mask.shape
        y, x = (np.indices((height, width)) + 0.5) / np.array([height, width])[:, None, None]
        places = [(a, b) for a in (0.2, 0.4, 0.6, 0.8) for b in (0.2, 0.4, 0.6, 0.8)]
        softer = np.stack([np.hypot(x - a, y - b) < 0.15 for a, b in places])
        touches = problem.background * np.where(softer, 0.5, 1.0)
        exact = problem.model.voltages(touches) - problem.background_voltages
        with torch.no_grad():
            voltages = self._operator.voltages(torch.from_numpy(touches).to(self._precision))
        error = (voltages - self._untouched).double().numpy() - exact
        return float(np.linalg.norm(error) / np.linalg.norm(exact))
