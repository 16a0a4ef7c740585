"""NOSER: one Gauss-Newton step whose prior is the diagonal of J^T J."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import ONE_STEP
from eitbench.methods.classical.one_step import GaussianStep
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array

# Between 0 (Tikhonov) and 1 (as first published); the usual choice, which keeps the rim calm.
EXPONENT = 0.5


def noser_covariance(jacobian: Array) -> Array:
    """Prior variances (P,) = diag(J^T J)^-0.5; a pixel that nothing sees gets the largest."""
    sensitivity = np.sum(jacobian**2, axis=0)
    floor = 1e-12 * sensitivity.max()
    return np.asarray(np.maximum(sensitivity, floor) ** -EXPONENT)


@register("noser")
@dataclass
class Noser(GaussianStep):
    """One Gauss-Newton step with the prior diag(J^T J)^0.5 (NOSER)."""

    source: ClassVar[str] = "Cheney et al., Int. J. Imaging Syst. Technol. 2(2), 1990"
    search: ClassVar = ONE_STEP

    def variances(self, jacobian: Array) -> Array:
        """C = diag(J^T J)^-0.5."""
        return noser_covariance(jacobian)
