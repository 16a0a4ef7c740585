"""Phantoms of a family as vectors of parameters, with their prior."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from eitbench.methods.shapes.raster import Grid, paint, pixel_grid
from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.phantoms.families import Family
from eitbench.scenarios.phantoms.phantom import Phantom
from eitbench.scenarios.phantoms.regions import Pose, Region
from eitbench.scenarios.sensors.sensor import Sensor

ROUND = ("circle", "ring")
"""Shapes that look the same at any angle."""
COPIES = {"rectangle": 4, "ellipse": 2, "star": 5}
"""Parameter vectors that give one and the same region, where there are more than one: a rectangle
may be turned by half of a turn, or by a quarter with its sides exchanged; an ellipse by half of a
turn, a star by a fifth."""

AREAS: Mapping[str, Callable[..., Array]] = {
    "circle": lambda radius: math.pi * radius**2,
    "ring": lambda outer, inner_ratio: math.pi * outer**2 * (1 - inner_ratio**2),
    "ellipse": lambda long, short: math.pi * long * short,
    "rectangle": lambda width, height: width * height,
    "triangle": lambda leg: leg**2 / 2,
    "l-shape": lambda arm, width: width * (2 * arm - width),
    "star": lambda outer, inner_ratio: 5 * math.sin(math.pi / 5) * outer**2 * inner_ratio,
}
"""Area of each shape of given sizes."""

STEP = {"place": 0.005, "angle": 0.02, "size": 0.005, "ratio": 0.02, "level": 0.02}
"""Small changes of parameters, each about as large for an image as the others."""

SLACK = 0.03
"""Of regions that are fitted with soft edges, which are that uncertain."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """Vectors (P,) for the phantoms of one family on one sensor.

    For each inclusion: place x and y and, if it matters, angle [rad], the sizes of the shape, and
    the conductivity over the background. Lengths are fractions of the sensor's side.

    Attributes:
        family: of a single shape.
        sensor: the nominal one.
        slack: part of the distances within a region by which it may be larger than the sensor
            allows.
    """

    family: Family
    sensor: Sensor
    slack: float = SLACK

    @cached_property
    def side(self) -> float:
        """The shorter side of the sensor's bounding box [m]."""
        x0, y0, x1, y1 = self.sensor.outline.bounds
        return min(x1 - x0, y1 - y0)

    @cached_property
    def _shape(self) -> tuple[str, tuple[str, ...], bool]:
        (shape,) = self.family.shapes
        return shape.name, tuple(shape.sizes), shape.name not in ROUND

    @cached_property
    def _table(self) -> Array:
        """(P, 3): least and greatest value, and step, of each parameter."""
        x0, y0, x1, y1 = (value / self.side for value in self.sensor.outline.bounds)
        rows = [(x0, x1, STEP["place"]), (y0, y1, STEP["place"])]
        if self._shape[2]:
            rows.append((-math.inf, math.inf, STEP["angle"]))
        for name, (low, high) in self.family.shapes[0].sizes.items():
            rows.append((low, high, STEP["ratio" if name.endswith("ratio") else "size"]))
        rows.append((*self.family.conductivity, STEP["level"]))
        return np.array(rows * self.family.count)

    @cached_property
    def _grid(self) -> Grid:
        return pixel_grid(self.sensor)

    @property
    def low(self) -> Array:
        """Least values (P,)."""
        return self._table[:, 0]

    @property
    def high(self) -> Array:
        """Greatest values (P,)."""
        return self._table[:, 1]

    @property
    def step(self) -> Array:
        """Small changes (P,)."""
        return self._table[:, 2]

    @cached_property
    def span(self) -> Array:
        """Ranges (P,) that the values are uniform in."""
        span = self.high - self.low
        return np.where(np.isfinite(span), span, 2 * math.pi)

    @cached_property
    def copies(self) -> int:
        """Vectors that give the same image."""
        each: int = COPIES.get(self._shape[0], 1)
        return math.factorial(self.family.count) * math.prod([each] * self.family.count)

    def inclusions(self, vector: Array) -> list[tuple[Region, float]]:
        """Regions and their conductivity over the background."""
        _, names, turned = self._shape
        found = []
        for part in vector.reshape(self.family.count, -1).tolist():
            x, y, *rest = part
            angle = rest.pop(0) if turned else 0.0
            sizes = {
                n: v if n.endswith("ratio") else v * self.side
                for n, v in zip(names, rest[:-1], strict=True)
            }
            pose = Pose(x * self.side, y * self.side, angle)
            found.append((self.family.shapes[0].build(sizes, pose), rest[-1]))
        return found

    def shifted(self, vector: Array, columns: float, rows: float) -> Array:
        """The vector (P,) of the same phantom so many pixels away, but within the ranges."""
        parts = vector.reshape(self.family.count, -1).copy()
        parts[:, 0] += columns * self._grid.width / self.side
        parts[:, 1] += rows * self._grid.height / self.side
        return np.asarray(parts.ravel().clip(self.low, self.high))

    def image(self, vector: Array, edge: float = 0.0) -> Array:
        """Conductivity over the background (H, W); `edge` in pixels, see `raster.paint`."""
        image = np.ones(self.sensor.image_shape)
        width = edge * math.sqrt(self._grid.width * self._grid.height)
        for region, level in self.inclusions(vector):
            paint(image, region, level, self._grid, width)
        return image

    def images(self, vectors: Array) -> Array:
        """Conductivity over the background (n, H, W) of vectors (n, P), with sharp edges."""
        return np.array([self.image(vector) for vector in vectors])

    def derivative(self, vector: Array, edge: float) -> Array:
        """Change of the image (P, H, W) with each parameter, times its step; `edge` in pixels."""
        changes = np.empty((len(vector), *self.sensor.image_shape))
        for k, (change, step) in enumerate(zip(changes, self.step, strict=True)):
            ahead, behind = vector.copy(), vector.copy()
            ahead[k] += step / 2
            behind[k] -= step / 2
            np.subtract(self.image(ahead, edge), self.image(behind, edge), out=change)
        return changes

    def of_phantom(self, phantom: Phantom) -> Array:
        """The vector (P,) of a phantom of the family."""
        _, names, turned = self._shape
        drawn, several = phantom.parameters, self.family.count > 1
        vector = []
        for k in range(self.family.count):
            number = f"_{k + 1}" if several else ""
            vector += [drawn[f"x{number}_m"] / self.side, drawn[f"y{number}_m"] / self.side]
            vector += [drawn[f"angle{number}_rad"]] if turned else []
            vector += [
                drawn[n] if n.endswith("ratio") else drawn[f"{n}{number}_m"] / self.side
                for n in names
            ]
            vector.append(drawn[f"conductivity{number}"] / phantom.background)
        return np.array(vector)

    def straightened(self, vectors: Array) -> tuple[Array, Array]:
        """Coordinates (n, P) of vectors (n, P), in which the shapes alike to a sensor lie straight.

        A frame tells the product of an inclusion's area and its (x - 1) / (x + 1) better than each
        of them: the strength of the dipole that stands for it (Polya and Szego 1951). The strength
        takes the place of the conductivity x. Also (n,) the logarithm of the volume of vectors
        over that of coordinates.
        """
        parts = self.parts(vectors)
        levels, areas = parts[..., -1], self._areas(parts)
        straight = parts.copy()
        straight[..., -1] = areas * (levels - 1) / (levels + 1)
        volume = np.log((levels + 1) ** 2 / (2 * areas)).sum(axis=1)
        return straight.reshape(vectors.shape), volume

    def bent(self, straight: Array) -> Array:
        """Vectors (n, P) of coordinates (n, P): the inverse of `straightened`.

        A strength of the area or more belongs to no conductivity: its vector is out of range.
        """
        parts = self.parts(straight).copy()
        factors = parts[..., -1] / self._areas(parts)
        with np.errstate(divide="ignore"):
            parts[..., -1] = (1 + factors) / (1 - factors)
        return np.asarray(parts.reshape(straight.shape))

    def parts(self, vectors: Array) -> Array:
        """Vectors (n, P) by inclusions: (n, count, values)."""
        return vectors.reshape(len(vectors), self.family.count, len(self.low) // self.family.count)

    def _areas(self, parts: Array) -> Array:
        """Areas (n, count) of inclusions (n, count, values), as fractions of the side's square."""
        first = 3 if self._shape[2] else 2
        sizes = dict(zip(self._shape[1], np.moveaxis(parts[..., first:-1], -1, 0), strict=True))
        return np.asarray(AREAS[self._shape[0]](**sizes)).clip(min=1e-9)

    def within(self, vectors: Array) -> Mask:
        """True (n,) for vectors (n, P) within their ranges."""
        return np.asarray(((vectors >= self.low) & (vectors <= self.high)).all(axis=1))

    def possible(self, vectors: Array) -> Mask:
        """True (n,) for vectors (n, P) within their ranges whose regions fit into the sensor.

        Regions may be out of it by `slack`.
        """
        possible = self.within(vectors)
        for k in np.flatnonzero(possible):
            regions = [region for region, _ in self.inclusions(vectors[k])]
            points = [self._shrunk(region) for region in regions]
            inside = self.sensor.outline.contains(*np.concatenate(points).T).all()
            possible[k] = inside and self._apart(points)
        return possible

    def _apart(self, points: list[Array]) -> bool:
        """True if regions of which these are `points` (k, 2) keep the family's distance."""
        centres = [of.mean(axis=0) for of in points]
        reach = [float(np.hypot(*(p - c).T).max()) for p, c in zip(points, centres, strict=True)]
        gap = (1 - self.slack) * self.family.gap * self.side
        return all(
            math.dist(centres[i], centres[j]) >= reach[i] + reach[j] + gap
            for i in range(len(points))
            for j in range(i)
        )

    def _shrunk(self, region: Region) -> Array:
        """Points (k, 2) [m] of the rim of a region, nearer to its place by `slack`."""
        place = np.array([region.pose.x, region.pose.y])
        return np.asarray(place + (1 - self.slack) * (region.rim() - place))
