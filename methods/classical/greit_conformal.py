"""The images of GREIT with the errors of place that it made on validation touches nearby."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eitbench.methods.classical.greit import Greit
from eitbench.methods.method import DRAWS, reconstructed
from eitbench.methods.problem import Problem
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.similarity import fit_similarity

TOUCHES = 500
"""Validation touches whose errors are known, at most."""
FEWEST = 10
"""Touches that are needed. Of fewer than `DRAWS` errors some are taken again."""
SPOT = 2.0
"""Standard deviation of a drawn spot, in pixels."""


@register("greit-conformal")
@dataclass
class GreitConformal(Greit):
    """The image of `greit`, and regions of the place that hold nearly as often as they say.

    The errors of place on the 39 validation touches that were seen nearest to a touch are taken
    for those that its own place may have. Each becomes a draw: a round spot there, as strong as the
    image. If touches to come are like those of validation, 95 % of the regions about 38 of 39 draws
    hold the true place, whatever the sensor, its model and the distribution of errors: nearly, and
    on average over touches, not for each. Spots say nothing of shape and size. Errors of a recorded
    set are those that a similarity to the coordinates of its robot leaves.
    """

    source: ClassVar[str] = (
        "Adler et al., Physiol. Meas. 30(6), 2009; Papadopoulos, Vovk and Gammerman, J. Artif. "
        "Intell. Res. 40, 2011 (conformal prediction with nearest neighbours)"
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
        found, true = self._places(reconstructed(self, problem, data)), _true_places(data)
        problem.reference = first
        known = np.isfinite(true).all(axis=1) & np.isfinite(found).all(axis=1)
        if known.sum() < FEWEST:
            raise InputError(
                f"The validation split of {data.scenario!r} has {known.sum()} touches whose place "
                f"is known and seen, and {FEWEST} are needed: name a scenario with more."
            )
        self._found, true = found[known], true[known]
        if data.conductivity is None:
            robot = fit_similarity(self._found, true)
            if robot is None:
                raise InputError(
                    f"The touches of the validation split of {data.scenario!r}, or the places that "
                    "GREIT finds of them, lie on one line, which does not tell the robot's "
                    "coordinates: name a scenario with others."
                )
            true = robot.inverse(true)
        self._errors = true - self._found

    def uncertainty(self, voltages: Array) -> Array:
        """Images (n, K, H, W) [S/m] of frames (n, M): spots where touches may be."""
        images = self.reconstruct(voltages)
        background = self._problem.background
        draws = np.full((len(images), DRAWS, *self._problem.mask.shape), background)
        for of, image, place in zip(draws, images, self._places(images), strict=True):
            contrast = np.where(self._problem.mask, image - background, 0.0)
            strength = contrast.flat[np.abs(contrast).argmax()]
            if strength != 0:  # else nothing is seen, and no place
                of += strength * self._spots(place + self._errors_near(place))
        return draws

    def _errors_near(self, place: Array) -> Array:
        """Errors (K, 2) [m] of the touches that were found nearest to a place (2,)."""
        nearest = np.argsort(np.hypot(*(self._found - place).T), kind="stable")
        return np.asarray(self._errors[np.resize(nearest[:DRAWS], DRAWS)])

    def _spots(self, places: Array) -> Array:
        """Spots (K, H, W) of height 1 at places (K, 2), outside the sensor at the nearest pixel."""
        sensor = self._problem.sensor
        x, y = sensor.pixel_centres
        inside = np.stack([x[sensor.mask], y[sensor.mask]], axis=1)
        outside = ~sensor.outline.contains(*places.T)
        nearest = np.hypot(*(places[outside, None] - inside).T).argmin(axis=0)
        places[outside] = inside[nearest]
        size = SPOT * max(sensor.pixel_size)
        away = (x - places[:, :1, None]) ** 2 + (y - places[:, 1:, None]) ** 2
        return np.asarray(np.exp(-away / (2 * size**2)))

    def _places(self, images: Array) -> Array:
        """Places (n, 2) [m] of touches in images (n, H, W) [S/m], NaN where there is none."""
        return locate(images, self._problem.sensor, self._problem.background)


def _true_places(data: Dataset) -> Array:
    """True places (n, 2) [m] of touches, NaN where there is none."""
    if data.conductivity is None:
        return data.samples.reindex(columns=["x_m", "y_m"]).to_numpy(np.float64)
    return locate(data.conductivity, data.sensor, data.sensor.background)
