"""Tikhonov regularisation: the contrast of least energy that explains the data."""

from dataclasses import dataclass
from typing import ClassVar

from eitbench.methods.classical.linearisation import ONE_STEP
from eitbench.methods.classical.one_step import OneStep, regularised_inverse
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array


@register("tikhonov")
@dataclass
class Tikhonov(OneStep):
    """One Gauss-Newton step with the identity as prior."""

    source: ClassVar[str] = "Vauhkonen et al., IEEE Trans. Med. Imaging 17(2), 1998"
    search: ClassVar = ONE_STEP

    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """J^T (J J^T + w I)^-1."""
        return regularised_inverse(jacobian, jacobian.T, self.weight)
