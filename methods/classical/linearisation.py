"""The linearised problem that the classical methods share: J x = dv on the sensor's pixels."""

import math
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError

Variable = Literal["conductivity", "clausius-mossotti"]
VARIABLES: tuple[Variable, ...] = get_args(Variable)


class Linearisation:
    """The linearised problem: the unknown, the weights of measurements, and images of unknowns.

    The unknown x is either the contrast (sigma - sigma_0) / sigma_0, as in the textbooks, or the
    2-D Clausius-Mossotti factor x = 2 (sigma - sigma_0) / (sigma + sigma_0): a small disc of any
    conductivity perturbs the voltages in exact proportion to it (Maxwell 1873, art. 314; in 2-D),
    so that far stronger contrasts are linear in it. Both agree to first order. Neither has a unit,
    so that a weight means the same on a sensor of any conductivity.

    Rows are divided by their norm to the power `row_exponent`: 0 trusts every volt alike (white
    noise, as on simulated boards), 1 trusts every measurement alike.

    Args:
        gain_power: of the gains of measurements that are taken out of data, see `Problem`.

    Attributes:
        jacobian: (M, P) weighted rows dv/dx at x = 0 on the P pixels inside the sensor.
        bounds: least and greatest x, from the sensor's conductivity range.
    """

    def __init__(
        self,
        problem: Problem,
        variable: Variable,
        row_exponent: float,
        gain_power: float = 0.0,
    ) -> None:
        if variable not in VARIABLES:
            raise InputError(f"A variable is one of {', '.join(VARIABLES)}, got {variable!r}.")
        if not (0 <= row_exponent <= 1 and 0 <= gain_power < math.inf):
            raise InputError(
                "The exponent of rows is from 0 to 1, and the power of gains at least 0; got "
                f"row_exponent={row_exponent} and gain_power={gain_power}."
            )
        self._problem = problem
        self._gain_power = gain_power
        self._variable = variable
        rows = problem.jacobian[:, problem.mask] * self.slope(np.zeros(1))
        norms = np.linalg.norm(rows, axis=1)
        floor = 1e-6 * norms.max()  # a row that sees nothing must not be blown up
        self._weights = (np.maximum(norms, floor) / norms.max()) ** -row_exponent
        self.jacobian: Array = self._weights[:, None] * rows
        low, high = problem.sensor.conductivity_range
        self.bounds = (self._unknown(low), self._unknown(high))

    def _unknown(self, multiple: float) -> float:
        """x of a conductivity given as a multiple of the background."""
        if self._variable == "conductivity":
            return multiple - 1
        return 2 * (multiple - 1) / (multiple + 1)

    def slope(self, x: Array) -> Array:
        """d sigma / dx [S/m] at `x`."""
        if self._variable == "conductivity":
            return np.full_like(x, self._problem.background)
        return np.asarray(4 * self._problem.background / (2 - x) ** 2)

    def data(self, voltages: Array) -> Array:
        """Weighted differences (n, M) from frames (n, M)."""
        return np.asarray(self._problem.difference(voltages, self._gain_power) * self._weights)

    def weighted(self, values: Array) -> Array:
        """Model voltages or rows (M, ...) under the same weighting."""
        return np.asarray((values.T * self._weights).T)

    def compression(self, negligible: float = 1e-12) -> Array:
        """(k, M) combinations of weighted measurements that carry all of the signal.

        Measurements repeat one another by reciprocity; the combinations are independent, keep the
        least-squares problem as it is, and scale the Jacobian's largest singular value to 1. Those
        whose singular value squared is `negligible` are left out.
        """
        energy, vectors = np.linalg.eigh(self.jacobian @ self.jacobian.T)
        kept = energy > negligible * energy[-1]
        return np.asarray(vectors[:, kept].T / np.sqrt(energy[-1]))

    def images(self, x: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from unknowns (n, P), kept within the bounds."""
        mask, background = self._problem.mask, self._problem.background
        x = np.clip(x, *self.bounds)
        images = np.full((len(x), *mask.shape), background)
        if self._variable == "conductivity":
            images[:, mask] *= 1 + x
        else:
            images[:, mask] *= (2 + x) / (2 - x)
        return images


def positive(name: str, value: object) -> None:
    """Raise `InputError` unless a parameter is a finite number above 0."""
    if not (isinstance(value, int | float) and 0 < value < math.inf):
        raise InputError(f"The parameter {name!r} is a number above 0, got {value!r}.")


def damping(gram: Array, weight: float) -> Array:
    """weight * mean(diag(gram)) * identity: a regularisation that does not depend on units.

    Raises:
        InputError: a weight that is not above 0.
    """
    positive("weight", weight)
    return np.asarray(weight * np.trace(gram) / len(gram) * np.eye(len(gram)))


Search = Mapping[str, Sequence[object]]

GAINS: Search = {"gain_power": (0.0, 0.5, 1.0)}
WEIGHTS: Search = {"weight": (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0)}
ROWS: Search = {"row_exponent": (0.0, 0.5, 1.0)}
UNKNOWN: Search = {"variable": VARIABLES}
ONE_STEP: Search = {**GAINS, **UNKNOWN, **WEIGHTS, **ROWS}
VARIATION: Search = {"weight": (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2)}
