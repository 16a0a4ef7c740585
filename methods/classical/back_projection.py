"""Linear back-projection: each measurement is smeared over the pixels that it is sensitive to."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import GAINS, ROWS, UNKNOWN, Linearisation, Variable
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array


@register("back-projection")
@dataclass
class BackProjection(Method):
    """Sensitivity-weighted back-projection, scaled to explain the data best.

    Attributes:
        variable, row_exponent, gain_power: see `Linearisation`.
    """

    source: ClassVar[str] = "Kotre, Clin. Phys. Physiol. Meas. 10(3), 1989"
    search: ClassVar = {**GAINS, **UNKNOWN, **ROWS}
    variable: Variable = "conductivity"
    row_exponent: float = 0.0
    gain_power: float = 0.0

    def fit(self, problem: Problem) -> None:
        """Normalise the sensitivity of each pixel."""
        self._linearisation = Linearisation(
            problem, self.variable, self.row_exponent, self.gain_power
        )
        jacobian = self._linearisation.jacobian
        total = np.sum(np.abs(jacobian), axis=0)
        self._smear = jacobian / np.maximum(total, 1e-6 * total.max())
        # Residuals are compared in the measurements: J times the smear is all that is needed.
        self._explained = self._smear @ jacobian.T

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M)."""
        data = self._linearisation.data(voltages)
        predicted = data @ self._explained
        energy = np.sum(predicted**2, axis=1)
        # The least-squares scale of the image; a frame without contrast stays without.
        scale = np.sum(predicted * data, axis=1) / np.where(energy > 0, energy, 1.0)
        return self._linearisation.images(scale[:, None] * (data @ self._smear))
