"""One Gauss-Newton step with a Laplacian prior: the smoothest contrast that explains the data."""

from dataclasses import dataclass
from typing import ClassVar

from eitbench.methods.classical.linearisation import ONE_STEP
from eitbench.methods.classical.one_step import OneStep, regularised_inverse
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.methods.smoothness import smoothed
from eitbench.scenarios.arrays import Array


@register("laplacian")
@dataclass
class Laplacian(OneStep):
    """One Gauss-Newton step with a first-order smoothness prior."""

    source: ClassVar[str] = "Polydorides and Lionheart, Meas. Sci. Technol. 13(12), 2002"
    search: ClassVar = ONE_STEP

    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """C J^T (J C J^T + w I)^-1 with C^-1 the Laplacian plus a little identity."""
        return regularised_inverse(jacobian, smoothed(jacobian, problem.mask), self.weight)
