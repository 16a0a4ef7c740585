"""Tikhonov regularisation: the contrast of least energy that explains the data."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.linearisation import ONE_STEP
from eitbench.methods.classical.one_step import GaussianStep
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array


@register("tikhonov")
@dataclass
class Tikhonov(GaussianStep):
    """One Gauss-Newton step with the identity as prior."""

    source: ClassVar[str] = "Vauhkonen et al., IEEE Trans. Med. Imaging 17(2), 1998"
    search: ClassVar = ONE_STEP

    def variances(self, jacobian: Array) -> Array:
        """C = I."""
        return np.ones(jacobian.shape[1])
