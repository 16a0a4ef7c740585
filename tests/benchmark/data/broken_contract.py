"""A plugin whose methods each break one promise of the contract."""

import os
from typing import Any

import numpy as np

from eitbench.methods import Method, Problem, register
from eitbench.scenarios.errors import InputError

Array = np.ndarray[Any, np.dtype[np.float64]]


class Sound(Method):
    """Keeps every promise."""

    def fit(self, problem: Problem) -> None:
        self.problem = problem
        self.spread = problem.jacobian.reshape(len(problem.jacobian), -1)
        self.spread = self.spread / np.abs(self.spread).sum() * 100

    def reconstruct(self, voltages: Array) -> Array:
        contrast = self.problem.difference(voltages) @ self.spread
        return self.problem.background + contrast.reshape(-1, *self.problem.mask.shape)


@register("contract-kept")
class Kept(Sound):
    """Keeps every promise."""


@register("contract-contrast")
class Contrast(Sound):
    """Forgets the background."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages) - self.problem.background


@register("contract-inverted")
class Inverted(Sound):
    """Has the sign wrong."""

    def reconstruct(self, voltages: Array) -> Array:
        return 2 * self.problem.background - super().reconstruct(voltages)


@register("contract-unsigned")
class Unsigned(Sound):
    """Sees every contact as resistive."""

    def reconstruct(self, voltages: Array) -> Array:
        background = self.problem.background
        return background - np.abs(super().reconstruct(voltages) - background)


@register("contract-batch")
class Batch(Sound):
    """Scales by what else is in the batch."""

    def reconstruct(self, voltages: Array) -> Array:
        background = self.problem.background
        contrast = super().reconstruct(voltages) - background
        return background + contrast * len(voltages)


@register("contract-random")
class Random(Sound):
    """Starts from what the system calls random."""

    def fit(self, problem: Problem) -> None:
        super().fit(problem)
        self.spread = self.spread * (1 + int.from_bytes(os.urandom(2)) / 2**16)


@register("contract-short")
class Short(Sound):
    """Pads frames that are too short."""

    def reconstruct(self, voltages: Array) -> Array:
        missing = len(self.problem.reference) - voltages.shape[1]
        return super().reconstruct(np.pad(voltages, ((0, 0), (0, missing))))


@register("contract-nan")
class Nan(Sound):
    """Takes a NaN for zero."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(np.nan_to_num(voltages))


@register("contract-own-grid")
class OwnGrid(Sound):
    """Keeps every promise where it exists: for the sensor's own image grid."""

    def fit(self, problem: Problem) -> None:
        if problem.mask.shape != (80, 80):
            raise InputError("There are weights for 80 x 80 pixels only.")
        super().fit(problem)
