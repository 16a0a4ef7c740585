"""Gauss-Newton updates of a guessed image, through the exact model, that explain the frame.

At a guess x (conductivity over background, on the P pixels of the sensor) the model predicts F(x)
with derivative J. If the guess is wrong by an error with covariance D, and the frame by noise of
standard deviation s, the update with the least expected error is linear in what is not explained,

    dx = D J^T (J D J^T + s^2 I)^-1 (dv - (F(x) - F(1))),

a Gauss-Newton step whose prior is the guess itself (Tarantola, Inverse Problem Theory, 2005,
eq. 3.51). D is diagonal: a guess is wrong where it changes. How noisy a frame is, is not known, so
that there is an update for each of a few noise levels; whoever uses them decides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, ndimage

from eitbench.scenarios.arrays import Array, Images
from eitbench.scenarios.sensors.patterns import equal_noise, independent

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem


SNR_DB = (70.0, 50.0, 35.0)
"""Noise levels that updates are made for; the first stands for clean frames."""

WINDOW = 0.1
"""Side of the square in which the range of a guess is taken, relative to the image's."""

# Fitted to the errors of the first `dnn`: their standard deviation rose in proportion to the range
# of its image around the pixel, from 0.03 at 0.06 to 0.33 at 0.98. Those of the shipped one rise to
# 0.15 only (200 training samples of `paper`). The value stays, as `learned-gn` was trained with it:
# a factor of all errors is the same as other noise levels, of which there are three.
ERROR_OF_RANGE = 0.35
LEAST_ERROR = 0.005


class GaussNewtonUpdate:
    """Updates of guesses for one problem."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._combine, norms = equal_noise(problem.sensor.pattern)
        self._first, _, _ = independent(problem.sensor.pattern)
        self._row_scale = (problem.background / norms).astype(np.float32)[:, None]
        rms = float(np.sqrt(np.mean(problem.background_voltages**2)))
        self._noise = rms * 10 ** (-np.array(SNR_DB) / 20)

    def __call__(self, difference: Array, guesses: Images) -> Images:
        """Updates (n, levels, H, W) of guesses (n, H, W), conductivity over background.

        Frames come as differences to the reference (n, M) [V/A], in model units.
        """
        updates = np.zeros((len(guesses), len(SNR_DB), *guesses.shape[1:]), dtype=np.float32)
        mask = self._problem.mask
        for update, guess, frame in zip(updates, guesses, difference, strict=True):
            update[:, mask] = self._of_one(guess, frame)
        return updates

    def _of_one(self, guess: Images, frame: Array) -> Images:
        """(levels, P) of one guess (H, W) and difference (M,)."""
        problem = self._problem
        sigma = guess.clip(*problem.sensor.conductivity_range) * problem.background
        # What reciprocity makes equal in voltages has equal derivatives: one of each will do.
        voltages, sensitivity = problem.model.linearise(sigma, self._first)
        rows = sensitivity.astype(np.float32)[:, problem.mask] * self._row_scale
        missing = (frame - (voltages - problem.background_voltages)) @ self._combine
        prior = rows * expected_error(guess)[problem.mask] ** 2
        energy, vectors = linalg.eigh((prior @ rows.T).astype(np.float64))
        # Rounding in float32 may leave energies below zero, which stand for none.
        weights = vectors.T @ missing / (np.maximum(energy, 0) + self._noise[:, None] ** 2)
        return np.asarray((weights @ vectors.T).astype(np.float32) @ prior)


def expected_error(guess: Images) -> Images:
    """Standard deviation (H, W) of the error of a guess (H, W), relative to the background."""
    side = [2 * max(1, round(WINDOW * size / 2)) + 1 for size in guess.shape]  # odd: symmetric
    local = ndimage.maximum_filter(guess, side) - ndimage.minimum_filter(guess, side)
    return np.asarray(LEAST_ERROR + ERROR_OF_RANGE * local, dtype=np.float32)
