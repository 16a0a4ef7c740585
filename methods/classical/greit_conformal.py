"""The images of GREIT with the errors of place that they had on validation touches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import ndimage

from eitbench.methods.classical.greit import Greit
from eitbench.methods.classical.one_step import numbers_of
from eitbench.methods.method import DRAWS, reconstructed
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.similarity import fit_similarity

ROUNDS = 4
"""Moves of an image, at most, until its place is within half a pixel of where it should be."""
TOUCHES = 500
"""Validation touches whose errors are kept, at most."""
FEWEST = 10
"""Touches that are needed. Of fewer than `DRAWS` some errors are drawn again, and the regions of
draws promise less."""


@register("greit-conformal")
@dataclass
class GreitConformal(Greit):
    """The image of `greit`, moved by the errors of place that it made on validation touches.

    If touches to come are like those of validation, the place of one is as likely as each of the
    drawn ones to be the farthest from their middle: 95 % of the regions about 38 of 39 draws hold
    it, whatever the sensor, its model and the distribution of errors (split conformal prediction).
    That is an average over touches, not a promise for each. Shapes and strengths do not vary.
    Errors of a recorded set are those that a similarity to its robot leaves.

    Attributes:
        as of `Greit`.
    """

    source: ClassVar[str] = (
        "Adler et al., Physiol. Meas. 30(6), 2009; Papadopoulos et al., ECML 2002 (split conformal)"
    )

    search: ClassVar = {}
    tuned_as: ClassVar = "greit"

    def fit(self, problem: Problem) -> None:
        """Compute the matrix, and the errors of place of validation touches.

        Raises:
            InputError: fewer than `FEWEST` of them have a known place.
        """
        super().fit(problem)
        first, data = problem.reference, problem.validation(TOUCHES)
        found = self._places(reconstructed(self, problem, data))
        problem.reference = first
        true = _true_places(data)
        known = np.isfinite(true).all(axis=1) & np.isfinite(found).all(axis=1)
        if data.conductivity is None:
            similarity = fit_similarity(found[known], true[known])
            true = true if similarity is None else similarity.inverse(true)
        if known.sum() < FEWEST:
            raise InputError(
                f"The validation split of {data.scenario!r} has {known.sum()} touches whose place "
                f"is known and seen, and {FEWEST} are needed: name a scenario with more."
            )
        self._errors = (true - found)[known]
        x, y = problem.sensor.pixel_centres
        self._pixel = np.array([y[1, 0] - y[0, 0], x[0, 1] - x[0, 0]])

    def uncertainty(self, voltages: Array) -> Array:
        """Images (n, K, H, W) [S/m] of frames (n, M), moved by errors that are drawn for each."""
        draws = np.empty((len(voltages), DRAWS, *self._problem.mask.shape))
        again = len(self._errors) < DRAWS
        images = self.reconstruct(voltages)
        places = self._places(images)
        for of, image, place, frame in zip(draws, images, places, voltages, strict=True):
            chosen = numbers_of(frame).choice(len(self._errors), DRAWS, replace=again)
            self._move(image, place + self._errors[chosen], of)
        return draws

    def _move(self, image: Array, places: Array, moved: Array) -> None:
        """Fill `moved` (K, H, W) with `image` (H, W) after moves that bring it to `places` (K, 2).

        At the rim a part of the image is lost, and the place of the rest is farther inside: it is
        moved on. Places outside are taken for the nearest ones inside.
        """
        x, y = (axis[self._problem.mask] for axis in self._problem.sensor.pixel_centres)
        nearest = np.hypot(places[:, :1] - x, places[:, 1:] - y).argmin(axis=1)
        outside = ~self._problem.sensor.outline.contains(*places.T)
        places = np.where(outside[:, None], np.stack([x, y], axis=1)[nearest], places)
        steps, off = np.zeros_like(places), places - self._places(image[None])
        far = np.arange(len(places))
        for _ in range(ROUNDS):
            steps[far] += np.nan_to_num(off[far])  # an image without a contact stays as it is
            for k in far:
                shift = steps[k, ::-1] / self._pixel
                ndimage.shift(image, shift, moved[k], order=1, cval=self._problem.background)
            off[far] = places[far] - self._places(moved[far])
            far = np.flatnonzero(np.hypot(*off.T) > np.abs(self._pixel).min() / 2)

    def _places(self, images: Array) -> Array:
        return locate(images, self._problem.sensor, self._problem.background)


def _true_places(data: Dataset) -> Array:
    """True places (n, 2) [m] of touches, NaN where there is none."""
    if data.conductivity is None:
        return data.samples[["x_m", "y_m"]].to_numpy(np.float64)
    return locate(data.conductivity, data.sensor, data.sensor.background)
