"""Phantoms of a family as vectors of parameters, with their prior."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from eitbench.methods.shapes.raster import Grid, paint_polygons, paint_rings, pixel_grid
from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.phantoms.families import Family
from eitbench.scenarios.phantoms.phantom import Phantom, size_column
from eitbench.scenarios.phantoms.press import FOAM
from eitbench.scenarios.phantoms.regions import RIM_POINTS, Circle
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
    the conductivity over the background, or the pressure of soft presses over the modulus of the
    foam. Lengths are fractions of the sensor's side.

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
        return self.sensor.outline.shorter_side

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
        soft, modulus = self.family.pressure, FOAM.modulus
        levels = (soft[0] / modulus, soft[1] / modulus) if soft else self.family.conductivity
        rows.append((*levels, STEP["level"]))
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

    def shifted(self, vector: Array, columns: float, rows: float) -> Array:
        """The vector (P,) of the same phantom so many pixels away, but within the ranges."""
        parts = vector.reshape(self.family.count, -1).copy()
        parts[:, 0] += columns * self._grid.width / self.side
        parts[:, 1] += rows * self._grid.height / self.side
        return np.asarray(parts.ravel().clip(self.low, self.high))

    def image(self, vector: Array, edge: float = 0.0) -> Array:
        """Conductivity over the background (H, W); `edge` in pixels, see `raster`."""
        return np.asarray(self.images(vector[None], edge)[0])

    def images(self, vectors: Array, edge: float = 0.0) -> Array:
        """Conductivity over the background (n, H, W) of vectors (n, P); `edge` in pixels."""
        images = np.ones((len(vectors), *self.sensor.image_shape))
        width = edge * math.sqrt(self._grid.width * self._grid.height)
        for part in np.moveaxis(self.parts(vectors), 1, 0):
            of, levels = self._metres(part), part[:, -1].copy()
            if self.family.pressure:
                pressures = FOAM.modulus * levels[:, None, None]
                images *= FOAM.pressed(pressures, self._distances(of))
            elif self._shape[2]:
                paint_polygons(images, self._corners(of), levels, self._grid, width)
            else:
                outer, inner = _radii(of.sizes)
                paint_rings(images, of.places, inner, outer, levels, self._grid, width)
        return images

    def _distances(self, of: "_Placed") -> Array:
        """Distances (n, H, W) [m] of pixels from discs or rectangles; 0 inside."""
        x, y = self.sensor.pixel_centres
        dx, dy = x - of.places[:, 0, None, None], y - of.places[:, 1, None, None]
        if not self._shape[2]:
            return np.asarray(np.hypot(dx, dy) - _radii(of.sizes)[0][:, None, None]).clip(min=0)
        cos, sin = (turn(of.angles)[:, None, None] for turn in (np.cos, np.sin))
        half = (of.sizes[name][:, None, None] / 2 for name in ("width", "height"))
        along = (np.abs(cos * dx + sin * dy), np.abs(cos * dy - sin * dx))
        beyond = [(a - h).clip(min=0) for a, h in zip(along, half, strict=True)]
        return np.asarray(np.hypot(*beyond))

    def derivative(self, vector: Array, edge: float) -> Array:
        """Change of the image (P, H, W) with each parameter, times its step; `edge` in pixels."""
        steps = np.diag(self.step / 2)
        ahead, behind = (self.images(vector + sign * steps, edge) for sign in (1, -1))
        return np.asarray(ahead - behind)

    def _metres(self, part: Array) -> "_Placed":
        """Of one inclusion (n, values): its places, angles and sizes."""
        _, names, turned = self._shape
        angles = part[:, 2] if turned else np.zeros(len(part))
        values = part[:, 3 if turned else 2 : -1].T
        sizes = {
            n: v if n.endswith("ratio") else v * self.side
            for n, v in zip(names, values, strict=True)
        }
        return _Placed(part[:, :2] * self.side, angles, sizes)

    def _corners(self, of: "_Placed") -> Array:
        """Corners (n, k, 2) [m] of polygons, and of those that are drawn around ellipses."""
        corners = self.family.shapes[0].corners
        if corners is not None:
            pairs = [np.stack(np.broadcast_arrays(x, y), axis=-1) for x, y in corners(of.sizes)]
            return of.placed(np.stack(pairs, axis=1))
        axes = np.stack([of.sizes["long"], of.sizes["short"]], axis=-1)
        return of.placed(_DISC * axes[:, None])

    def rims(self, vectors: Array) -> Array:
        """Points (n, count, k, 2) [m] of the rims of regions, as those of `Region.rim`."""
        rims = []
        for part in np.moveaxis(self.parts(vectors), 1, 0):
            of = self._metres(part)
            if not self._shape[2]:
                rims.append(of.placed(_DISC * _radii(of.sizes)[0][:, None, None]))
                continue
            corners = self._corners(of)
            polygons = self.family.shapes[0].corners is not None
            rims.append(with_points_between(corners, RIM_POINTS) if polygons else corners)
        return np.stack(rims, axis=1)

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
                drawn[size_column(n, number)] / (1 if n.endswith("_ratio") else self.side)
                for n in names
            ]
            if self.family.pressure:
                vector.append(drawn[f"pressure{number}_pa"] / FOAM.modulus)
            else:
                vector.append(drawn[f"conductivity{number}"] / phantom.background)
        return np.array(vector)

    def straightened(self, vectors: Array) -> tuple[Array, Array]:
        """Coordinates (n, P) of vectors (n, P), in which the shapes alike to a sensor lie straight.

        A frame tells the product of an inclusion's area and its (x - 1) / (x + 1) better than each
        of them: the strength of the dipole that stands for it (Polya and Szego 1951). The strength
        takes the place of the conductivity x. Also (n,) the logarithm of the volume of vectors
        over that of coordinates. Pressures stay as they are.
        """
        if self.family.pressure:
            return vectors.copy(), np.zeros(len(vectors))
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
        if self.family.pressure:
            return straight.copy()
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
        kept = vectors[possible]
        places = self.parts(kept)[:, :, None, :2] * self.side
        points = places + (1 - self.slack) * (self.rims(kept) - places)
        inside = self.sensor.outline.contains(points[..., 0], points[..., 1]).all(axis=(1, 2))
        possible[possible] = inside & self._apart(points)
        return possible

    def _apart(self, points: Array) -> Mask:
        """True (n,) if regions with these `points` (n, count, k, 2) keep the family's distance."""
        centres = points.mean(axis=2)
        reach = np.hypot(*np.moveaxis(points - centres[:, :, None], -1, 0)).max(axis=2)
        gap = (1 - self.slack) * self.family.gap * self.side
        apart = np.ones(len(points), dtype=bool)
        for i, j in combinations(range(self.family.count), 2):
            distance = np.hypot(*(centres[:, i] - centres[:, j]).T)
            apart &= distance >= reach[:, i] + reach[:, j] + gap
        return apart


class _Placed(NamedTuple):
    """Regions of one shape.

    Attributes:
        places: (n, 2) [m].
        angles: (n,) [rad].
        sizes: (n,) of each size [m], but ratios.
    """

    places: Array
    angles: Array
    sizes: Mapping[str, Array]

    def placed(self, points: Array) -> Array:
        """Points (n, k, 2) [m] about the origin, turned and shifted to the poses."""
        cos, sin = np.cos(self.angles), np.sin(self.angles)
        turns = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=1)
        return np.asarray(points @ turns + self.places[:, None])


_DISC = Circle(1.0).rim()
"""Corners (k, 2) of a polygon drawn around a disc of radius 1."""


def _radii(sizes: Mapping[str, Array]) -> tuple[Array, Array]:
    """The outer and inner radii (n,) [m] of rings, and of discs."""
    if "radius" in sizes:
        return sizes["radius"], np.zeros_like(sizes["radius"])
    return sizes["outer"], sizes["outer"] * sizes["inner_ratio"]


@compiled
def with_points_between(corners: Array, count: int) -> Array:
    """Corners (n, k, 2) of polygons with `count` points between them, evenly along the rims."""
    n, k = corners.shape[:2]
    found = np.empty((n, k + count, 2))
    for polygon in range(n):
        found[polygon, :k] = corners[polygon]
        ends = np.zeros(k + 1)
        for side in range(k):
            step = corners[polygon, (side + 1) % k] - corners[polygon, side]
            ends[side + 1] = ends[side] + np.sqrt(step[0] * step[0] + step[1] * step[1])
        side = 0
        for point in range(count):
            along = ends[k] * point / count
            while side < k - 1 and along >= ends[side + 1]:
                side += 1
            share = (along - ends[side]) / (ends[side + 1] - ends[side])
            start, end = corners[polygon, side], corners[polygon, (side + 1) % k]
            found[polygon, k + point] = start + share * (end - start)
    return found
