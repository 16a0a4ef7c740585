"""The design of tactile acuity: touches on a lattice of places, pairs of them, and none.

Nothing in it is drawn at random, so that scenarios of other noise have the same touches, and maps
over the sensor compare. Touches are soft presses of one round indenter
(`scenarios.phantoms.press`).
"""

import itertools
import math
from collections.abc import Iterator
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from eitbench.scenarios.declaration import Declaration
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.phantom import Phantom, SoftPress
from eitbench.scenarios.phantoms.press import FOAM, PRESSURE_PA
from eitbench.scenarios.phantoms.regions import Circle, Pose
from eitbench.scenarios.sensors.sensor import Sensor

Part = Literal["no-touch", "touch", "pair"]
"""The family of a sample: a frame without a touch, a single touch, or a pair of touches."""

FEWEST_PLACES = 5
"""A lattice of fewer places is no map."""
LEAST_SIDE_M = 2 * FOAM.thickness
"""Where a sensor is narrower, a touch presses all of it down."""
FEWEST_UNTOUCHED = 100
"""Fewer frames without a touch hold no threshold for 1 % of false alarms."""

LEAST_STEP = 0.02
"""A finer lattice has tens of thousands of touches."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, lt=1)]


class Acuity(Declaration):
    """Parameters of the design; lengths are fractions of the sensor's shorter side.

    Attributes:
        pressures: of single touches [Pa], rising.
        draws: of the noise, for each place and pressure.
        untouched: frames without a touch, which the threshold is taken from.
        radius: of the indenter.
        room: least distance from the indenter to the rim.
        step: of the lattice, as a fraction of the geometric mean of the sensor's two sides.
        distances: between the centres of the two touches of a pair, rising.
        pair_pressure: of both touches of a pair [Pa].
    """

    pressures: tuple[Positive, ...] = (500.0, 2000.0, 5000.0, 15000.0, 40000.0)
    draws: int = Field(default=2, ge=1)
    untouched: int = Field(default=102, ge=FEWEST_UNTOUCHED)
    radius: Fraction = 0.06
    room: Fraction = 0.02
    step: float = Field(default=0.17, ge=LEAST_STEP, lt=1)
    distances: tuple[Fraction, ...] = (0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
    pair_pressure: Positive = 20000.0

    @field_validator("pressures", "distances")
    @classmethod
    def _rising(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) < 3 or list(value) != sorted(set(value)):
            raise ValueError("at least three rising numbers are needed")
        return value

    @field_validator("pressures", "pair_pressure")
    @classmethod
    def _within_the_law(cls, value: tuple[float, ...] | float) -> tuple[float, ...] | float:
        if np.max(value) > PRESSURE_PA[1]:
            raise ValueError(f"the law of the foam holds up to {PRESSURE_PA[1]:g} Pa")
        return value

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if self.distances[0] < 2 * self.radius:
            raise ValueError("two indenters are at least one diameter apart: give larger distances")
        return self

    def places(self, sensor: Sensor) -> list[tuple[float, float]]:
        """Return the places of the lattice [m], row by row: those that have room for the indenter.

        Raises:
            InputError: there are fewer than `FEWEST_PLACES`, or the foam spreads a touch over the
                whole sensor.
        """
        if (side := sensor.outline.shorter_side) < LEAST_SIDE_M:
            raise InputError(
                f"Sensor {sensor.name!r} is {1e3 * side:.3g} mm wide, and its foam, "
                f"{1e3 * FOAM.thickness:g} mm thick, spreads a touch as far: acuity needs a sensor "
                f"of at least {1e3 * LEAST_SIDE_M:g} mm."
            )
        x0, y0, x1, y1 = sensor.outline.bounds
        step = self.step * float(np.sqrt((x1 - x0) * (y1 - y0)))
        columns, rows = (
            [(low + high) / 2 + k * step for k in range(-half, half + 1)]
            for low, high in ((x0, x1), (y0, y1))
            for half in (int((high - low) / 2 / step),)
        )
        found = [(x, y) for y in rows for x in columns if self._fits(x, y, sensor)]
        if len(found) < FEWEST_PLACES:
            raise InputError(
                f"Sensor {sensor.name!r} has room for {len(found)} places of a touch, and a map of "
                f"acuity needs at least {FEWEST_PLACES}: choose a smaller `radius`, `room` or "
                "`step` in [scenarios.acuity]."
            )
        return found

    def _fits(self, x: float, y: float, sensor: Sensor) -> bool:
        around = Circle((self.radius + self.room) * sensor.outline.shorter_side, Pose(x, y))
        corners = sensor.outline.point(sensor.outline.corners).T
        return bool(
            sensor.outline.contains(*around.rim().T).all() and not around.contains(*corners).any()
        )

    def design(self, sensor: Sensor) -> list[Phantom]:
        """Return the phantom of every sample.

        Raises:
            InputError: the sensor has no room for the lattice.
        """
        places = self.places(sensor)
        frames = [*self._touches(places, sensor), *self._pairs(places, sensor)]
        blank = Phantom("no-touch", "no-touch", sensor.background, (), {})
        # Untouched frames lie evenly among the others, so that any first part holds some.
        at = [(np.arange(count) + 0.5) / count for count in (self.untouched, len(frames))]
        together = [*[blank] * self.untouched, *frames]
        return [together[k] for k in np.argsort(np.concatenate(at), kind="stable").tolist()]

    def _touches(self, places: list[tuple[float, float]], sensor: Sensor) -> Iterator[Phantom]:
        # The draws are outermost, so that those of one touch have different reference frames.
        each = itertools.product(range(self.draws), enumerate(places), self.pressures)
        for _, (k, place), pressure in each:
            yield self._phantom("touch", k, [place], pressure, sensor)

    def _pairs(self, places: list[tuple[float, float]], sensor: Sensor) -> Iterator[Phantom]:
        for (k, (x, y)), distance in itertools.product(enumerate(places), self.distances):
            for angle in np.pi / 4 * np.arange(4):  # along the axes and the diagonals
                half = (
                    distance
                    * sensor.outline.shorter_side
                    / 2
                    * np.array([np.cos(angle), np.sin(angle)])
                )
                both = [(float(x + s * half[0]), float(y + s * half[1])) for s in (-1, 1)]
                if all(self._fits(*one, sensor) for one in both):
                    yield self._phantom("pair", k, both, self.pair_pressure, sensor)

    def _phantom(
        self,
        part: Part,
        place: int,
        centres: list[tuple[float, float]],
        pressure: float,
        sensor: Sensor,
    ) -> Phantom:
        radius = self.radius * sensor.outline.shorter_side
        presses = tuple(SoftPress(Circle(radius, Pose(x, y)), pressure) for x, y in centres)
        parameters = {"place": float(place), "pressure_pa": pressure, "radius_m": radius}
        for (x, y), k in zip(centres, ("", "2"), strict=False):
            parameters |= {f"x{k}_m": x, f"y{k}_m": y}
        if part == "pair":
            parameters["probe_distance_mm"] = 1e3 * math.dist(*centres)
        return Phantom(part, part, sensor.background, presses, parameters)
