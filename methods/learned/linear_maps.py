"""Linear maps learned from simulated data: to images, which networks must beat, and of touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eitbench.methods.classical.linearisation import GAINS, damping
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array, Images, unit_frames
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import averaging
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from eitbench.scenarios.data.datasets import Dataset


WEIGHTS = (1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Regularisations to choose from, relative to the mean variance of the inputs."""


class Ridge(NamedTuple):
    """A linear map (K, P), the weight it was regularised with, and its validation error."""

    matrix: Images
    weight: float
    validation_mse: float


def ridge(inputs: Array, targets: Images, seen_inputs: Array, seen_targets: Images) -> Ridge:
    """The map with the least validation error: (X^T X + w t I)^-1 X^T Y, t = tr(X^T X) / K.

    There is no intercept: the reference frame gives the background.

    Args:
        inputs: X (n, K), standardised differences.
        targets: Y (n, P), contrasts.
        seen_inputs, seen_targets: the same of the validation split, which chooses w.
    """
    energy, vectors = np.linalg.eigh(inputs.T @ inputs)
    rotated = (vectors.T @ inputs.T).astype(np.float32) @ targets
    candidates = []
    for weight in WEIGHTS:
        scale = 1 / (np.maximum(energy, 0) + weight * energy.mean())
        matrix = (vectors * scale).astype(np.float32) @ rotated
        error = seen_inputs.astype(np.float32) @ matrix - seen_targets
        candidates.append(Ridge(matrix, weight, float(np.mean(error**2))))
    return min(candidates, key=lambda candidate: candidate.validation_mse)


TRAINING, VALIDATION = 4000, 600
"""Samples that are learned from: a hundred inputs are known well, and simulating them is quick."""

LEARNED_NO_SYMMETRY = "it learns from touches at random places, which it does not turn or mirror"
"""Reason why it lacks the sensor's symmetry, on the few samples that `eitbench check` has."""


@register("linear-learned")
@dataclass
class LinearLearned(Method):
    """Ridge regression of images on voltages, over the training split; the baseline of learning.

    The validation split chooses the regularisation, or, where its true images are not known, as of
    real presses, a part of the training split that is then not learned from.

    The map is for frames with the faults and gains that the first reference frame shows. Those of
    later sessions are estimated as if they had none, which errs more where electrodes died since.

    Attributes:
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
    """

    source: ClassVar[str] = "Hoerl and Kennard, Technometrics 12(1), 1970"
    expected_failures: ClassVar = asymmetry(LEARNED_NO_SYMMETRY)
    trains: ClassVar = True
    # Nothing to search: `fit` chooses by the validation split, which tuning keeps for itself.
    gain_power: float = 0.0

    def fit(self, problem: Problem) -> None:
        """Solve for the map."""
        self._problem = problem
        self._averaging = averaging(problem.sensor.pattern)
        if problem.validation(1).conductivity is None:
            frames, images = self._learned(problem.training(TRAINING + VALIDATION))
            first = len(frames) * TRAINING // (TRAINING + VALIDATION)
            inputs, seen = frames[:first], frames[first:]
            targets, expected = images[:first], images[first:]
        else:
            inputs, targets = self._learned(problem.training(TRAINING))
            seen, expected = self._learned(problem.validation(VALIDATION))
        self._std = np.maximum(inputs.std(axis=0), 1e-6 * inputs.std(axis=0).max())
        found = ridge(inputs / self._std, targets, seen / self._std, expected)
        self._matrix = found.matrix.astype(np.float64)

    def _learned(self, data: Dataset) -> tuple[Array, Images]:
        """Frames (n, K) of `data` as they are estimated, averaged, and their contrasts (n, P)."""
        frames = self._problem.as_estimated(self._problem.differences(data), self.gain_power)
        return np.asarray(frames @ self._averaging), contrasts(data, self._problem)

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        inputs = self._problem.difference(voltages, self.gain_power) @ self._averaging
        return absolute(inputs / self._std @ self._matrix, self._problem)


def absolute(contrast: Array, problem: Problem) -> Array:
    """Images (n, H, W) [S/m], within the sensor's range, of relative contrasts (n, P)."""
    low, high = problem.sensor.conductivity_range
    images = np.full((len(contrast), *problem.mask.shape), problem.background)
    images[:, problem.mask] *= np.clip(1 + contrast, low, high)
    return images


def contrasts(data: Dataset, problem: Problem) -> NDArray[np.float32]:
    """Relative contrasts (n, P) of the pixels inside the sensor.

    Raises:
        InputError: the conductivity of `data` is not known.
    """
    if data.conductivity is None:
        raise InputError(
            f"Scenario {data.scenario!r} has no true images to learn from: learn from a simulated "
            "one."
        )
    inside = data.conductivity[:, problem.mask] / problem.background - 1
    return inside.astype(np.float32)


TOUCHES = 6000
"""Touches that are learned from at most: as many as the suite `presses` declares."""


@register("linear-touch")
@dataclass
class LinearTouch(Method):
    """Ridge regression of unit images on unit frames: every touch counts alike, however strong.

    A map that minimises the error of images is decided by the strongest and largest touches, and
    a real sensor is touched far more weakly than it is simulated. Here frames are divided by their
    rms and images by the sum of their contrast, so that only *where* is learned. One factor, from
    least squares over the same data, brings the strength back. For sessions see `LinearLearned`.

    Attributes:
        weight: of the ridge, relative to the mean variance of the inputs.
        gain_power: of the gains of measurements that are taken out of frames, see `Problem`.
    """

    source: ClassVar[str] = "Hoerl and Kennard, Technometrics 12(1), 1970"
    expected_failures: ClassVar = asymmetry(LEARNED_NO_SYMMETRY)
    trains: ClassVar = True
    search: ClassVar = {
        **GAINS,
        "weight": (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0),
    }
    weight: float = 0.3
    gain_power: float = 0.0

    def fit(self, problem: Problem) -> None:
        """Solve for the map from the training split."""
        self._problem = problem
        data = problem.training(TOUCHES)
        frames = problem.as_estimated(problem.differences(data), self.gain_power)
        images = contrasts(data, problem).astype(np.float64)
        total = np.abs(images).sum(axis=1, keepdims=True)
        known = total[:, 0] > 0  # a frame equal to the reference has no place
        frames, images, total = frames[known], images[known], total[known]
        unit = unit_frames(frames)
        gram = unit.T @ unit
        matrix = np.linalg.solve(gram + damping(gram, self.weight), (unit / total).T @ images)
        # <shown, images> / <shown, shown>, without making shown = frames @ matrix (n, P).
        strength = np.vdot(matrix, frames.T @ images)
        self._matrix = matrix * (strength / np.vdot(matrix, frames.T @ frames @ matrix))

    def reconstruct(self, voltages: Array) -> Array:
        """Absolute conductivity (n, H, W) [S/m] from frames (n, M), within the sensor's range."""
        difference = self._problem.difference(voltages, self.gain_power)
        return absolute(difference @ self._matrix, self._problem)
