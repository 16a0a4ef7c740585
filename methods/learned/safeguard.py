"""A safeguard: learned images are taken where they explain the frame, images of NOSER elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eitbench.methods.classical.noser import Noser

if TYPE_CHECKING:
    from eitbench.methods.problem import Problem
    from eitbench.scenarios.arrays import Array, Images

REGULARISATION = 0.01
"""NOSER's weight: what suits 30 dB to clean."""


class Safeguard:
    """Takes a learned image unless NOSER's image of the frame explains it better.

    A network shows what it has learned, whatever the frame is. On a sensor like that of its
    training its image explains a frame far better than NOSER's; where the frame is of another kind,
    far worse. Both are asked the exact model F: the misfit of an image p of a difference d is
    ||d - (F(p) - F(untouched))||.

    Source: Heaton, Chen, Wang and Yin, AAAI 37(6), 2023 (Safe-L2O: a learned step is taken where it
    does not raise the objective, a classical one elsewhere).
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._noser = Noser(REGULARISATION, "clausius-mossotti")
        self._noser.fit(problem)

    def __call__(self, learned: Images, difference: Array) -> Images:
        """The images (n, H, W), over the background, to take of differences (n, M) [V/A]."""
        first = self._first(difference)
        kept = self._misfit(learned, difference) <= self._misfit(first, difference)
        return np.where(kept[:, None, None], learned, first)

    def novelty(self, learned: Images, difference: Array) -> Array:
        """How many times worse learned images (n, H, W) explain their frames than NOSER's (n,)."""
        own, first = (
            self._misfit(images, difference) for images in (learned, self._first(difference))
        )
        return own / np.maximum(first, np.finfo(np.float64).tiny)

    def _first(self, difference: Array) -> Images:
        images = self._noser.of_difference(difference) / self._problem.background
        return images.astype(np.float32)

    def _misfit(self, images: Images, difference: Array) -> Array:
        """||d - (F(p) - F(untouched))|| (n,) [V/A]; outside the sensor no image counts."""
        problem = self._problem
        inside = np.where(problem.mask, images.clip(*problem.sensor.conductivity_range), 1.0)
        voltages = problem.model.voltages(inside.astype(np.float64) * problem.background)
        explained = voltages - problem.background_voltages
        return np.asarray(np.linalg.norm(difference - explained, axis=1))
