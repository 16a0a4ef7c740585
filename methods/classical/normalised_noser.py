"""NOSER on normalised differences: one gain a measurement, from the reference frame.

Boards and skins are not what their model is: channels differ, common-mode voltage leaks into
differences, the gel is uneven. To first order each measurement is then the modelled one times a
gain g_m of its own, and the reference frame shows it: g_m = |v_ref,m| / |V_m|. J x = dv becomes
g_m J_m x = dv_m, or, divided by v_ref, the normalised difference dv_m / v_ref,m = J_m x / V_m, here
with noise that is equal in volts, so that weak measurements count little.

Source: Barber and Seagar, Clin. Phys. Physiol. Meas. 8 (1987) suppl. A, 47, for normalised
differences.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.noser import noser_covariance
from eitbench.methods.classical.one_step import OneStep, regularised_inverse
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array

LARGEST_GAIN = 10.0
"""A gain that is larger, or smaller than its inverse, is taken for a measurement near zero."""


def gains_of_reference(problem: Problem) -> Array:
    """Gains (M,) of the measurements over their median, within `LARGEST_GAIN` of it."""
    modelled = np.abs(problem.background_voltages)
    measured = np.abs(problem.reference / problem.gain)
    floor = 1e-6 * modelled.max()
    gains = np.maximum(measured, floor) / np.maximum(modelled, floor)
    return np.asarray(np.clip(gains / np.median(gains), 1 / LARGEST_GAIN, LARGEST_GAIN))


@register("normalised-noser")
@dataclass
class NormalisedNoser(OneStep):
    """NOSER with one gain a measurement, that of the reference frame over the modelled one.

    Attributes:
        weight: as for `OneStep`; the default suits the validation presses of real skins.
        exponent: of the prior diag(J^T J)^exponent, 0 (Tikhonov) to 1.
    """

    source: ClassVar[str] = (
        "Barber and Seagar, Clin. Phys. Physiol. Meas. 8 (1987) suppl. A, 47; "
        "Cheney et al., Int. J. Imaging Syst. Technol. 2(2), 1990"
    )
    search: ClassVar = {"weight": (0.3, 1.0, 3.0, 10.0), "exponent": (0.0, 0.25, 0.5, 0.75)}
    weight: float = 3.0
    exponent: float = 0.5

    def fit(self, problem: Problem) -> None:
        """Compute the reconstruction matrix for the gains of the present reference frame."""
        self._reference = problem.reference.copy()
        super().fit(problem)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M); another reference is fitted."""
        if not np.array_equal(self._problem.reference, self._reference):
            self.fit(self._problem)
        return super().reconstruct(voltages)

    def gains(self, problem: Problem) -> Array:
        """See `gains_of_reference`."""
        return gains_of_reference(problem)

    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """C J^T (J C J^T + w I)^-1 with C = diag(J^T J)^-exponent, J with its gains."""
        covariance = noser_covariance(jacobian, self.exponent)
        return regularised_inverse(jacobian, covariance[:, None] * jacobian.T, self.weight)
