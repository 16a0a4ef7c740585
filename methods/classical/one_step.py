"""One-step linear methods: x = R dv with a matrix R that is computed once."""

import zlib
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from eitbench.methods.classical.linearisation import Linearisation, Variable, damping
from eitbench.methods.method import DRAWS, Method
from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array

OFFSETS = 400
"""Draws about the image that are made once; each frame takes `DRAWS` of them."""


@dataclass
class OneStep(Method):
    """Base of the one-step methods; a subclass says which matrix it uses.

    Attributes:
        weight: regularisation relative to the mean diagonal of the regularised Gram matrix.
        variable, row_exponent, gain_power: what is estimated from which data, see `Linearisation`.
    """

    weight: float = 0.03
    variable: Variable = "conductivity"
    row_exponent: float = 0.0
    gain_power: float = 0.0

    def fit(self, problem: Problem) -> None:
        """Compute the reconstruction matrix."""
        self._problem = problem
        self._linearisation = Linearisation(
            problem, self.variable, self.row_exponent, self.gain_power
        )
        matrix = self.matrix(self._linearisation.jacobian, problem)
        self._matrix = self._linearisation.weighted(np.ascontiguousarray(matrix.T))

    @abstractmethod
    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """R (P, M) from the weighted Jacobian (M, P) on the pixels inside the sensor."""

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M)."""
        return self.of_difference(self._problem.difference(voltages, self.gain_power))

    def of_difference(self, difference: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from differences to the reference (n, M) [V/A]."""
        return self._linearisation.images(difference @ self._matrix)


@dataclass
class GaussianStep(OneStep):
    """Base of the one-step methods with a Gaussian prior of independent pixels.

    The image is the mean of the posterior N(x, C - R J C) of the prior N(0, C) and of white noise,
    whose variance the regularisation gives as a multiple of C. Pixels vary by the standard
    deviation of a uniform law over the sensor's range of conductivity, in the root of the mean
    square, which settles both. Like the posterior of any linear model, its width in the unknown is
    the same for all frames. Draws are normal about the image in S/m, by the slope of the unknown
    there, and may leave the sensor's range: kept within it, half of them would equal the untouched
    background wherever this is the range's end.

    Source: Kaipio and Somersalo, Statistical and Computational Inverse Problems (2005), sec. 3.4;
    draws as Papandreou and Yuille, NIPS 23, 2010: the prior's, corrected by their own data.
    """

    @abstractmethod
    def variances(self, jacobian: Array) -> Array:
        """Diagonal (P,) of the prior covariance C, up to a factor."""

    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """R = C J^T (J C J^T + w I)^-1."""
        variances = self.variances(jacobian)
        shown = variances[:, None] * jacobian.T
        gram = jacobian @ shown
        noise = damping(gram, self.weight)
        rng = np.random.default_rng(0)
        prior = rng.standard_normal((OFFSETS, len(variances))) * np.sqrt(variances)
        measured = prior @ jacobian.T + rng.standard_normal((OFFSETS, len(gram))) * np.sqrt(
            noise[0, 0]
        )
        matrix = regularised_inverse(jacobian, shown, self.weight)
        low, high = problem.sensor.conductivity_range
        size = (high - low) / np.sqrt(12 * variances.mean())
        self._offsets = size * (prior - measured @ matrix.T)
        return matrix

    def uncertainty(self, voltages: Array) -> Array:
        """Draws (n, K, H, W) [S/m] from the posterior of frames (n, M)."""
        linearisation, mask = self._linearisation, self._problem.mask
        data = linearisation.data(voltages)
        mean = self._problem.difference(voltages, self.gain_power) @ self._matrix
        slope = linearisation.slope(np.clip(mean, *linearisation.bounds))
        draws = np.repeat(linearisation.images(mean)[:, None], DRAWS, axis=1)
        for n, frame in enumerate(data):
            # Frames have draws of their own, the same each time.
            rng = np.random.default_rng(zlib.crc32(frame.astype(np.float32).tobytes()))
            chosen = rng.choice(OFFSETS, DRAWS, replace=False)
            draws[n][:, mask] += slope[n] * self._offsets[chosen]
        return draws


def regularised_inverse(jacobian: Array, prior_times_transpose: Array, weight: float) -> Array:
    """C J^T (J C J^T + w I)^-1 (P, M), C the prior covariance, given C J^T (P, M).

    w is `weight` times the mean of the diagonal of J C J^T. The identity
    (J^T J / w + C^-1)^-1 J^T / w = C J^T (J C J^T + w I)^-1 trades a system in the pixels for one
    in the measurements.
    """
    gram = jacobian @ prior_times_transpose
    factor = linalg.cho_factor(gram + damping(gram, weight))
    return np.asarray(linalg.cho_solve(factor, prior_times_transpose.T).T)
