"""GREIT: the linear map that best turns the voltages of small targets into their blurred images."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import linalg

from eitbench.methods.classical.linearisation import (
    GAINS,
    ROWS,
    UNKNOWN,
    WEIGHTS,
    damping,
    positive,
)
from eitbench.methods.classical.one_step import OneStep
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array

# Training targets: discs of this radius on a square lattice of this many across the sensor.
TARGET_RADIUS = 0.05
TARGETS_ACROSS = 40


@register("greit")
@dataclass
class Greit(OneStep):
    """Trained on small targets everywhere to give round, uniform, blurred images (GREIT).

    Attributes:
        blur: radius of the desired image of a point, as a fraction of the sensor's longer side.
    """

    source: ClassVar[str] = "Adler et al., Physiol. Meas. 30(6), 2009"
    search: ClassVar = {**GAINS, **UNKNOWN, **WEIGHTS, "blur": (0.05, 0.08, 0.12), **ROWS}
    blur: float = 0.08

    def matrix(self, jacobian: Array, problem: Problem) -> Array:
        """X Y^T (Y Y^T + w I)^-1: X desired images (P, t), Y = J targets (M, t)."""
        positive("blur", self.blur)
        targets, desired = self._training(problem)
        voltages = jacobian @ targets
        gram = voltages @ voltages.T
        factor = linalg.cho_factor(gram + damping(gram, self.weight))
        return np.asarray(linalg.cho_solve(factor, voltages @ desired.T).T)

    def _training(self, problem: Problem) -> tuple[Array, Array]:
        """Targets and desired images (P, t), each with unit sum, so that area is kept."""
        x0, y0, _, _ = problem.sensor.outline.bounds
        side = problem.sensor.outline.longer_side
        x, y = (c[problem.mask] for c in problem.sensor.pixel_centres)
        steps = (np.arange(TARGETS_ACROSS) + 0.5) / TARGETS_ACROSS * side
        cx, cy = (c.ravel() for c in np.meshgrid(x0 + steps, y0 + steps))
        inside = problem.sensor.outline.contains(cx, cy)
        distance = np.hypot(x[:, None] - cx[inside], y[:, None] - cy[inside]) / side
        edge = max(problem.sensor.pixel_size) / side
        target = _soft_disc(distance, TARGET_RADIUS, edge)
        desired = _soft_disc(distance, TARGET_RADIUS + self.blur, self.blur / 2)
        return target / target.sum(axis=0), desired / desired.sum(axis=0)


def _soft_disc(distance: Array, radius: float, edge: float) -> Array:
    """A disc whose rim falls from 1 to 0 as a sigmoid of width `edge`."""
    return np.asarray(0.5 - 0.5 * np.tanh((distance - radius) / edge))
