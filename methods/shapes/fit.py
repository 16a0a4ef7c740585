"""Least-squares fits of shapes, to an image and to a frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from eitbench.methods.problem import Problem
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.patterns import equal_noise, independent

EDGE = 1.0
"""Width of the soft edge in fits [pixels]: the image then changes smoothly with the parameters."""
LARGEST_STEP = 10.0
"""A step changes no parameter by more than so many of its `Parameters.step`."""
GAIN = 1e-3
"""A fit ends when a step lowers the error by less than this share."""


class FrameModel:
    """The exact model, in independent combinations of measurements that have equal noise.

    Attributes:
        count: their number K.
        repeated: M - K, the number of measurements that only repeat others, by reciprocity.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._combine, norms = equal_noise(problem.sensor.pattern)
        self._first, _, _ = independent(problem.sensor.pattern)
        self._row_scale = (problem.background / norms)[:, None]
        self._range = problem.sensor.conductivity_range
        self._untouched = problem.background_voltages
        self.count = len(norms)
        self.repeated = problem.sensor.pattern.n_measurements - len(norms)

    def data(self, difference: Array) -> Array:
        """Combinations (..., K) of differences to the reference (..., M) [V/A]."""
        return np.asarray(difference @ self._combine)

    def noise(self, difference: Array) -> float:
        """Estimated sum of squares [(V/A)^2] of the noise in `data` of a frame (M,).

        No conductivity tells reciprocal measurements apart, so that what they differ by is noise.
        It is 0 where no measurement repeats another, and what the model cannot explain has no part
        in it.
        """
        differ = float(difference @ difference - np.square(self.data(difference)).sum())
        return max(differ, 0.0) * self.count / max(self.repeated, 1)

    def differences(self, image: Array) -> Array:
        """What the model predicts (K,) [V/A] for an image (H, W), relative to the background."""
        voltages = self._problem.model.voltages(self._sigma(image))
        return np.asarray((voltages - self._untouched) @ self._combine)

    def linearised(self, image: Array) -> LinearisedModel:
        """The model to first order about an image (H, W), from one elimination."""
        # What reciprocity makes equal in voltages has equal derivatives: one of each will do.
        voltages, rows = self._problem.model.linearise(self._sigma(image), self._first)
        rows = (rows.reshape(self.count, -1) * self._row_scale).T.copy()
        return LinearisedModel(image.ravel(), (voltages - self._untouched) @ self._combine, rows)

    def _sigma(self, image: Array) -> Array:
        return image.clip(*self._range) * self._problem.background


@dataclass(frozen=True, eq=False)
class LinearisedModel:
    """`FrameModel` to first order about one image.

    Attributes:
        image: (H * W,) that image, relative to the background.
        predicted: (K,) differences [V/A] at it.
        rows: (H * W, K) derivative of the differences.
    """

    image: Array
    predicted: Array
    rows: Array

    def differences(self, images: Array) -> Array:
        """What is predicted (..., K) [V/A] for images (..., H, W), relative to the background.

        A pixel that changes from c to x counts as 2 c (x - c) / (x + c), which is what a disc of
        conductivity x in c does to the field (Clausius and Mossotti): where shapes move, pixels
        along their edges change by all of the contrast, and x - c would err more.
        """
        flat = images.reshape(*images.shape[:-2], -1)
        # Shapes change few pixels.
        moved = np.flatnonzero((np.atleast_2d(flat) != self.image).any(axis=0))
        pixels, before = flat[..., moved], self.image[moved]
        changes = 2 * before * (pixels - before) / (pixels + before)
        return np.asarray(self.predicted + changes @ self.rows[moved])

    def times(self, changes: Array) -> Array:
        """Derivative times changes (..., H * W) of the image: (..., K)."""
        moved = np.flatnonzero(np.any(np.atleast_2d(changes), axis=0))
        return np.asarray(changes[..., moved] @ self.rows[moved])


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters that were fitted.

    Attributes:
        parameters: what they mean.
        vector: (P,).
        error: sum of squares, [(V/A)^2] of a frame and without a unit of an image.
        information: (P, P) Gauss-Newton matrix of the error, in steps of the parameters.
    """

    parameters: Parameters
    vector: Array
    error: float
    information: Array


def fit_image(parameters: Parameters, vector: Array, image: Array, steps: int) -> Fit:
    """Fit to an image (H, W), relative to the background, from `vector` (P,) on."""
    return _fitted(
        parameters,
        vector,
        steps,
        lambda guess: (image - guess).ravel(),
        lambda guess, changes: ((image - guess).ravel(), changes.T),
    )


def fit_frame(
    parameters: Parameters, vector: Array, model: FrameModel, data: Array, steps: int
) -> Fit:
    """Fit to the combinations `data` (K,) [V/A] of a frame, from `vector` (P,) on."""

    def slopes(guess: Array, changes: Array) -> tuple[Array, Array]:
        about = model.linearised(guess)
        return data - about.differences(guess), about.times(changes).T

    return _fitted(parameters, vector, steps, lambda guess: data - model.differences(guess), slopes)


def _fitted(
    parameters: Parameters,
    vector: Array,
    steps: int,
    residual: Callable[[Array], Array],
    slopes: Callable[[Array, Array], tuple[Array, Array]],
) -> Fit:
    """Levenberg and Marquardt's method within the ranges of the parameters.

    Args:
        parameters, vector: what is fitted, from where.
        steps: at most.
        residual: what is left (N,) of the data at an image (H, W).
        slopes: the same and the derivative (N, P) by parameters whose steps change the image by
            (P, H * W).
    """
    damping, image = 1e-3, parameters.image(vector, EDGE)
    for _ in range(steps):
        changes = parameters.derivative(vector, EDGE).reshape(len(vector), -1)
        missing, matrix = slopes(image, changes)
        error = float(missing @ missing)
        information, gradient = matrix.T @ matrix, matrix.T @ missing
        scale = np.diag(np.diag(information) + 1e-9 * np.trace(information))
        if not scale.any():  # it lies where nothing is seen
            break
        for _ in range(4):
            step = linalg.solve(information + damping * scale, gradient, assume_a="pos")
            step = step.clip(-LARGEST_STEP, LARGEST_STEP) * parameters.step
            shifted = (vector + step).clip(parameters.low, parameters.high)
            moved = parameters.image(shifted, EDGE)
            rest = residual(moved)
            if (lower := float(rest @ rest)) < error:
                break
            damping *= 10
        else:
            break
        vector, image, damping = shifted, moved, damping / 5
        small, error = lower > (1 - GAIN) * error, lower
        if small:
            break
    return Fit(parameters, vector, error, information)
