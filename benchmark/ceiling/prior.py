"""The law that phantoms are drawn by, as a density over their parameters.

`scenarios.phantoms.phantom.draw` takes a family, draws sizes s and conductivities uniformly, and
then tries places and angles, uniform over the sensor's bounding box, until the inclusions fit. A
vector of parameters theta that fits therefore has the density

    p(theta) = C / (V Z(s)),

with V the volume of all ranges, C the number of vectors that give the same phantom, and Z(s) the
share of places at which inclusions of these sizes fit. (Particles begin as draws of the generator,
so that V and C do not matter to them.) Z is counted: `TRIES` random places for each
of `SIZES` random sizes, and log Z is a polynomial of the sizes fitted to these counts (Poisson
regression), whose degree is `DEGREE`.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.arrays import Array, Index, Mask
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.families import Family
from eitbench.scenarios.phantoms.phantom import draw
from eitbench.scenarios.phantoms.regions import RIM_POINTS
from eitbench.scenarios.sensors.sensor import Sensor

SIZES, TRIES = 400, 400
DEGREE = 3
RIM_SLACK = 1 - math.cos(math.pi / RIM_POINTS)
"""Slack: the generator looks at polygons around round regions, at any angle. It refuses one of a
thousand vectors that fit with it."""
PERIODS = {"rectangle": math.pi, "ellipse": math.pi, "star": 2 * math.pi / 5}
"""Angle after which a shape looks the same, where that is less than a full turn."""
CENTRINGS = 4
"""How often the mean that vectors stand about is found anew."""
MOST = 5
"""Inclusions of a family: all their orders are compared."""


@dataclass(frozen=True, eq=False)
class FamilyPrior:
    """The law of one family on one sensor.

    Several vectors give the same phantom: inclusions may be in any order, and a shape may be turned
    by its period, or a rectangle by a quarter with its sides exchanged. Of these, one *stands* for
    the phantom about a centre (P,): the one with the inclusions nearest to those of the centre and
    with the angles nearest to its angles. Draws of a posterior that are close to each other as
    phantoms are then close as vectors, too.

    Attributes:
        parameters: of the family, with one shape.
        share: of the phantoms of the family that have this shape.
    """

    parameters: Parameters
    share: float

    @classmethod
    def of(cls, family: Family, sensor: Sensor) -> tuple[FamilyPrior, ...]:
        """The law of the phantoms of each shape of `family`, which are drawn equally often.

        Raises:
            InputError: a family whose phantoms are not vectors of parameters.
        """
        unknown = f"The ceiling is not known for family {family.name!r}: it needs "
        if family.levels:
            raise InputError(f"{unknown}conductivities or pressures that are drawn from a range.")
        if family.count > MOST:
            raise InputError(f"{unknown}at most {MOST} inclusions, not {family.count}.")
        found = []
        for shape in family.shapes:
            unlike = shape.name == "rectangle" and shape.sizes["width"] != shape.sizes["height"]
            ranges = [*shape.sizes.values(), family.pressure or family.conductivity]
            if unlike or any(low >= high for low, high in ranges):
                raise InputError(
                    f"{unknown}ranges that have a width, the same for both sides of a rectangle."
                )
            alone = Parameters(replace(family, shapes=(shape,)), sensor, slack=RIM_SLACK)
            found.append(cls(alone, 1 / len(family.shapes)))
        return tuple(found)

    @property
    def shape(self) -> str:
        """Name of the shape."""
        return self.parameters.family.shapes[0].name

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Vectors (count, P), from the generator of phantoms itself."""
        family, sensor = self.parameters.family, self.parameters.sensor
        drawn = (draw(family, sensor, rng) for _ in range(count))
        return np.array([self.parameters.of_phantom(phantom) for phantom in drawn])

    def centre(self, vectors: Array) -> Array:
        """The mean (P,) of vectors (n, P) that stand about it, nearly."""
        centre: Array = vectors[0]
        for _ in range(CENTRINGS):
            centre = self.arranged(vectors, centre).mean(axis=0)
        return centre

    def arranged(self, vectors: Array, centre: Array) -> Array:
        """The vectors (n, P) that stand for the phantoms of `vectors` (n, P) about a centre."""
        parts = self.parameters.parts(vectors)
        order = self._orders[self._nearest(vectors, centre)]
        ordered = np.take_along_axis(parts, order[..., None], axis=1).reshape(vectors.shape)
        found = self.unwrapped(ordered, centre)
        if self.shape == "rectangle":  # x, y, angle, width, height, level
            of, about = self.parameters.parts(found), self.parameters.parts(centre[None])
            away = of[..., 2] - about[..., 2]
            turned = np.abs(away) > math.pi / 4
            of[turned, 3], of[turned, 4] = of[turned, 4], of[turned, 3]
            of[turned, 2] -= math.pi / 2 * np.sign(away[turned])
        return found

    def unwrapped(self, vectors: Array, centre: Array) -> Array:
        """Vectors (n, P) with angles within half of a period of those of a centre (P,)."""
        turns = ~np.isfinite(self.parameters.high)
        period = PERIODS.get(self.shape, 2 * math.pi)
        around = (vectors - centre + period / 2) % period + centre - period / 2
        return np.where(turns, around, vectors)

    def standing(self, vectors: Array, centre: Array) -> Mask:
        """True (n,) for unwrapped vectors (n, P) in their ranges that stand about a centre (P,)."""
        standing = self.parameters.within(vectors) & (self._nearest(vectors, centre) == 0)
        if self.shape == "rectangle":
            away = self.parameters.parts(vectors - centre)[..., 2]
            standing &= (np.abs(away) <= math.pi / 4).all(axis=1)
        return np.asarray(standing)

    def _nearest(self, vectors: Array, centre: Array) -> Index:
        """The number (n,) of the order of inclusions whose places are nearest to a centre's."""
        places, to = (self.parameters.parts(of)[..., :2] for of in (vectors, centre[None]))
        squares = ((places[:, :, None] - to[:, None]) ** 2).sum(axis=-1)
        count = self.parameters.family.count
        return np.asarray(squares[:, self._orders, np.arange(count)].sum(axis=-1).argmin(axis=-1))

    @cached_property
    def _orders(self) -> Index:
        """The orders (count!, count) of inclusions, that of the vector first."""
        return np.array(list(itertools.permutations(range(self.parameters.family.count))))

    def fitting(self, vectors: Array) -> Mask:
        """True (n,) for vectors (n, ...), filled up or not, whose phantoms fit into the sensor."""
        return self.parameters.possible(vectors[:, : len(self.parameters.low)])

    def log_density(self, vectors: Array) -> Array:
        """log p (n,) of vectors (n, P) that stand for phantoms which fit into the sensor."""
        constant = math.log(self.parameters.copies) - np.log(self.parameters.span).sum()
        return np.asarray(constant - self._powers(vectors) @ self._log_share)

    def _powers(self, vectors: Array) -> Array:
        """Polynomials (n, terms) of the sizes, each scaled to -1 .. 1.

        They are the same for all vectors of a phantom: the sizes of inclusions are ordered by the
        first of them, and the sides of a rectangle by themselves.
        """
        sized, count = self._sized, self.parameters.family.count
        low, high = self.parameters.low[sized], self.parameters.high[sized]
        scaled = ((2 * vectors[:, sized] - low - high) / (high - low)).reshape(
            len(vectors), count, -1
        )
        if self.shape == "rectangle":
            scaled = np.sort(scaled, axis=2)
        order = np.argsort(scaled[..., :1], axis=1)
        ordered = np.take_along_axis(scaled, order, axis=1).reshape(len(vectors), -1)
        degrees = itertools.product(range(DEGREE + 1), repeat=int(sized.sum()))
        terms = [np.prod(ordered**degree, axis=1) for degree in degrees if sum(degree) <= DEGREE]
        return np.stack(terms, axis=1)

    @cached_property
    def _log_share(self) -> Array:
        """Coefficients (terms,) of log Z, by Poisson regression of counts."""
        rng, parameters = np.random.default_rng(0), self.parameters
        low = np.where(np.isfinite(parameters.low), parameters.low, 0.0)
        vectors = low + parameters.span * rng.random((SIZES, len(low)))
        terms = self._powers(vectors)
        counts = np.array([self._fitting(vector, rng) for vector in vectors])
        found = np.zeros(terms.shape[1])
        found[0] = math.log(counts.mean() / TRIES)
        for _ in range(20):
            expected = TRIES * np.exp(terms @ found)
            step = np.linalg.solve((terms.T * expected) @ terms, terms.T @ (counts - expected))
            found += step
        return found

    @cached_property
    def _sized(self) -> Mask:
        """True (P,) where a value is a size."""
        each = len(self.parameters.low) // self.parameters.family.count
        first = each - 1 - len(self.parameters.family.shapes[0].sizes)
        of_one = (np.arange(each) >= first) & (np.arange(each) < each - 1)
        return np.tile(of_one, self.parameters.family.count)

    def _fitting(self, vector: Array, rng: np.random.Generator) -> int:
        """At how many of `TRIES` random places inclusions of these sizes fit."""
        family, sensor = self.parameters.family, self.parameters.sensor
        x0, y0, x1, y1 = sensor.outline.bounds
        centres = self.parameters.parts(vector[None])[0, :, :2] * self.parameters.side
        rims = self.parameters.rims(vector[None])[0] - centres[:, None]
        places = rng.uniform((x0, y0), (x1, y1), size=(TRIES, len(rims), 2))
        fits = np.ones(TRIES, dtype=bool)
        for i, j in itertools.combinations(range(len(rims)), 2):
            reach = sum(float(np.hypot(*rims[k].T).max()) for k in (i, j))
            away = np.linalg.norm(places[:, i] - places[:, j], axis=1)
            fits &= away >= reach + family.gap * self.parameters.side
        for k, rim in enumerate(rims):
            turned = np.exp(1j * rng.uniform(0, 2 * math.pi, (TRIES, 1))) * (rim @ (1, 1j))
            points = places[:, k, :1] + turned.real, places[:, k, 1:] + turned.imag
            fits &= sensor.outline.contains(*points).all(axis=1)
        return int(fits.sum())
