"""The linear map from a frame to the place of a touch, learned from simulated touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.methods.classical.linearisation import damping
from eitbench.methods.learned.linear_learned import LEARNED_NO_SYMMETRY, absolute, contrasts
from eitbench.methods.method import Method
from eitbench.methods.registry import register
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem

Array = NDArray[np.float64]

TRAINING = 2000
"""Touches that are learned from: simulating them takes seconds."""


@register("linear-touch")
@dataclass
class LinearTouch(Method):
    """Ridge regression of unit images on unit frames: every touch counts alike, however strong.

    A map that minimises the error of images is decided by the strongest and largest touches, and
    a real sensor is touched far more weakly than it is simulated. Here frames are divided by their
    rms and images by the sum of their contrast, so that only *where* is learned. One factor, from
    least squares over the same data, brings the strength back.

    Attributes:
        weight: of the ridge, relative to the mean variance of the inputs.
    """

    source: ClassVar[str] = "Hoerl and Kennard, Technometrics 12(1), 1970"
    expected_failures: ClassVar = asymmetry(LEARNED_NO_SYMMETRY, 0.36, 0.38)
    search: ClassVar = {"weight": (0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 3.0)}
    weight: float = 0.3

    def fit(self, problem: Problem) -> None:
        """Solve for the map from the training split."""
        self._problem = problem
        data = problem.training(TRAINING)
        frames = data.voltages - data.reference  # simulated: in V/A whatever the board's units
        images = contrasts(data, problem).astype(np.float64)
        total = np.abs(images).sum(axis=1, keepdims=True)
        known = total[:, 0] > 0  # a frame equal to the reference has no place
        frames, images, total = frames[known], images[known], total[known]
        unit = unit_frames(frames)
        gram = unit.T @ unit
        matrix = np.linalg.solve(gram + damping(gram, self.weight), unit.T @ (images / total))
        shown = frames @ matrix
        self._matrix = matrix * (np.vdot(shown, images) / np.vdot(shown, shown))

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        return absolute(self._problem.difference(voltages) @ self._matrix, self._problem)


def unit_frames(frames: ArrayLike) -> Array:
    """Differences (n, M) in any unit divided by their rms; a frame of zeros stays as it is."""
    values = np.asarray(frames, dtype=np.float64)
    rms = np.sqrt(np.mean(values**2, axis=1, keepdims=True))
    return np.asarray(values / np.where(rms > 0, rms, 1.0))
