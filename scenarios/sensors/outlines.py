"""Outlines of sensors: closed curves in metres, walked counter-clockwise along their rim."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError

_ROUNDING = 1e-12


class _Bounded(ABC):
    """What follows from the bounding box of an outline."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, y_min, x_max, y_max) [m]."""

    @property
    def centre(self) -> Array:
        """Middle (2,) of the bounding box [m]."""
        x0, y0, x1, y1 = self.bounds
        return np.array([(x0 + x1) / 2, (y0 + y1) / 2])

    @property
    def shorter_side(self) -> float:
        """Of the bounding box [m]."""
        x0, y0, x1, y1 = self.bounds
        return min(x1 - x0, y1 - y0)

    @property
    def longer_side(self) -> float:
        """Of the bounding box [m]."""
        x0, y0, x1, y1 = self.bounds
        return max(x1 - x0, y1 - y0)


@dataclass(frozen=True)
class Polygon(_Bounded):
    """A simple polygon; `vertices` are (x, y) [m] in counter-clockwise order, the first is s = 0.

    Raises:
        InputError: fewer than three vertices, clockwise order, a coordinate that is no finite
            number, or sides that cross or touch each other.
    """

    vertices: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if not np.isfinite(np.array(self.vertices, dtype=np.float64)).all():
            raise InputError("A vertex of a polygon has a coordinate that is no finite number.")
        if len(self.vertices) < 3:
            raise InputError(f"A polygon needs at least 3 vertices, got {len(self.vertices)}.")
        x, y = self._closed[:-1].T
        if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) <= 0:
            raise InputError("The vertices of a polygon must run counter-clockwise around an area.")
        ends = np.stack([self._closed[:-1], self._closed[1:]])
        low, high = ends.min(axis=0), ends.max(axis=0)
        for k in range(len(self.vertices)):
            # Of a traced outline's many sides only those whose boxes meet are looked at one by one.
            boxes = (low[k + 1 :] <= high[k]) & (low[k] <= high[k + 1 :])
            for m in np.flatnonzero(boxes.all(axis=1)) + k + 1:
                if self._sides_meet(k, int(m)):
                    raise InputError(
                        f"Sides {k} and {m} of a polygon cross or touch each other (side 0 goes "
                        "from the first vertex to the second): list the vertices along its rim, "
                        "each once."
                    )

    def _sides_meet(self, k: int, m: int) -> bool:
        """True if two sides whose boxes meet, k < m, share more than the vertex between them."""
        (a, b), (c, d) = self._closed[k : k + 2].tolist(), self._closed[m : m + 2].tolist()
        if m == k + 1:
            return _turns_back(a, b, d)
        if (k, m) == (0, len(self.vertices) - 1):
            return _turns_back(c, a, b)
        return _turn(a, b, c) * _turn(a, b, d) <= 0 and _turn(c, d, a) * _turn(c, d, b) <= 0

    @cached_property
    def _closed(self) -> Array:
        return np.array([*self.vertices, self.vertices[0]], dtype=np.float64)

    @cached_property
    def _arc(self) -> Array:
        sides = np.hypot(*np.diff(self._closed, axis=0).T)
        return np.concatenate([[0.0], np.cumsum(sides)])

    @property
    def perimeter(self) -> float:
        """Length of the rim [m]."""
        return float(self._arc[-1])

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounding box (x_min, y_min, x_max, y_max) [m]."""
        low, high = self._closed.min(axis=0), self._closed.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @property
    def corners(self) -> Array:
        """Arc lengths (n_vertices,) [m] of the vertices."""
        return self._arc[:-1]

    def point(self, s: ArrayLike) -> Array:
        """Points (..., 2) [m] at arc lengths `s` (...) [m]; `s` wraps around the rim."""
        wrapped = np.mod(s, self.perimeter)
        x, y = self._closed.T
        return np.stack([np.interp(wrapped, self._arc, x), np.interp(wrapped, self._arc, y)], -1)

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside (even-odd rule)."""
        px, py = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        inside = np.zeros(px.shape, dtype=bool)
        for (x0, y0), (x1, y1) in zip(self._closed[:-1], self._closed[1:], strict=True):
            if y0 == y1:
                continue
            crosses = (y0 > py) != (y1 > py)
            inside ^= crosses & (px < x0 + (py - y0) * (x1 - x0) / (y1 - y0))
        return inside

    def reaches(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside or, but for rounding, on the rim."""
        points = np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float)), -1)
        side, begin = np.diff(self._closed, axis=0), self._closed[:-1]
        with np.errstate(invalid="ignore"):  # of places that are not finite
            along = ((points[..., None, :] - begin) * side).sum(axis=-1) / (side**2).sum(axis=-1)
            nearest = begin + along.clip(0, 1)[..., None] * side
            away = np.linalg.norm(points[..., None, :] - nearest, axis=-1).min(axis=-1)
        return np.asarray(self.contains(x, y) | (away <= _ROUNDING * self.perimeter))

    def describe(self) -> dict[str, object]:
        """Return all that defines the outline as plain values, for hashing and printing."""
        return {"polygon": [list(v) for v in self.vertices]}


def _turn(a: list[float], b: list[float], c: list[float]) -> float:
    """Positive where the way from `a` over `b` to `c` turns left, 0 where it does not turn."""
    turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return float(np.sign(turn))


def _turns_back(a: list[float], b: list[float], c: list[float]) -> bool:
    """True if the way from `a` over `b` to `c` goes back on itself, or does not move."""
    back = (a[0] - b[0]) * (c[0] - b[0]) + (a[1] - b[1]) * (c[1] - b[1])
    return b in (a, c) or (_turn(a, b, c) == 0 and back > 0)


def rectangle(width: float, height: float) -> Polygon:
    """A `width` x `height` [m] rectangle with its lower-left corner, s = 0, at the origin.

    Raises:
        InputError: a side that is not positive.
    """
    if not (width > 0 and height > 0):
        raise InputError(f"A rectangle needs positive sides, got {width} x {height} m.")
    return Polygon(((0.0, 0.0), (width, 0.0), (width, height), (0.0, height)))


@dataclass(frozen=True)
class Disc(_Bounded):
    """A disc of `radius` [m] centred at the origin; s = 0 lies on the positive x axis."""

    radius: float

    def __post_init__(self) -> None:
        if not 0 < self.radius < np.inf:
            raise InputError(f"A disc needs a positive radius, got {self.radius} m.")

    @property
    def perimeter(self) -> float:
        """Length of the rim [m]."""
        return 2 * np.pi * self.radius

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounding box (x_min, y_min, x_max, y_max) [m]."""
        return -self.radius, -self.radius, self.radius, self.radius

    @property
    def corners(self) -> Array:
        """Arc lengths [m] of the corners: a disc has none."""
        return np.empty(0)

    def point(self, s: ArrayLike) -> Array:
        """Points (..., 2) [m] at arc lengths `s` (...) [m]; `s` wraps around the rim."""
        angle = np.asarray(s, float) / self.radius
        return self.radius * np.stack([np.cos(angle), np.sin(angle)], -1)

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside."""
        return np.asarray(np.hypot(x, y) < self.radius)

    def reaches(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside or, but for rounding, on the rim."""
        return np.asarray(np.hypot(x, y) <= self.radius * (1 + _ROUNDING))

    def describe(self) -> dict[str, object]:
        """Return all that defines the outline as plain values, for hashing and printing."""
        return {"disc": self.radius}


Outline = Polygon | Disc
"""A closed curve; arc length `s` [m] runs counter-clockwise from a fixed start point."""


def is_rectangle(outline: Outline) -> bool:
    """True if the pixel grid fills the outline exactly (an axis-parallel rectangle)."""
    if not isinstance(outline, Polygon) or len(outline.vertices) != 4:
        return False
    x0, y0, x1, y1 = outline.bounds
    return set(outline.vertices) == {(x0, y0), (x1, y0), (x1, y1), (x0, y1)}
