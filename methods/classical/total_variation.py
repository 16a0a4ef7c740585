"""Total variation: the image with the least jumps that explains the data, within bounds."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import (
    GAINS,
    ROWS,
    UNKNOWN,
    VARIATION,
    Linearisation,
    Variable,
)
from eitbench.methods.classical.tv_solver import ANISOTROPY, TVSolver
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.symmetry import asymmetry

# ADMM steps: on clean foam16 frames 100 and 300 give the same SSIM to 0.002.
ITERATIONS = 100
# Frames solved together: more do not run faster and take more memory.
BATCH = 32


@register("tv")
@dataclass
class TotalVariation(Method):
    """Total variation on the linearised problem, conductivity kept within bounds.

    Attributes:
        weight: of the total variation, relative to the Jacobian's largest singular value squared.
        variable, row_exponent, gain_power: see `Linearisation`.
    """

    source: ClassVar[str] = "Borsic et al., IEEE Trans. Med. Imaging 29(1), 2010"
    expected_failures: ClassVar = asymmetry(ANISOTROPY)
    search: ClassVar = {**GAINS, **UNKNOWN, **VARIATION, **ROWS}
    weight: float = 1e-3
    variable: Variable = "conductivity"
    row_exponent: float = 0.0
    gain_power: float = 0.0

    def fit(self, problem: Problem) -> None:
        """Factorise the linearised problem."""
        self._linearisation = Linearisation(
            problem, self.variable, self.row_exponent, self.gain_power
        )
        self._compression = self._linearisation.compression()
        self._mask = problem.mask
        rows = np.zeros((len(self._compression), *problem.mask.shape))
        rows[:, problem.mask] = self._compression @ self._linearisation.jacobian
        self._solver = TVSolver(rows, self.weight, self._linearisation.bounds)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M)."""
        data = self._linearisation.data(voltages) @ self._compression.T
        unknown = np.empty((len(data), int(self._mask.sum())))
        for first in range(0, len(data), BATCH):
            frames = data[first : first + BATCH]
            state = self._solver.run(frames, self._solver.start(len(frames)), ITERATIONS)
            unknown[first : first + BATCH] = state.image[:, self._mask]
        return self._linearisation.images(unknown)
