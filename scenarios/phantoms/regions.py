"""Regions of a sensor as analytic shapes in metres."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.outlines import Polygon

# Points on the rim of a curved region: the corners of a polygon drawn around it, so that a region
# whose rim points all lie in a convex outline lies in it wholly.
RIM_POINTS = 64


@dataclass(frozen=True)
class Pose:
    """Place of a shape: its centre (x, y) [m] and its rotation `angle` [rad]."""

    x: float = 0.0
    y: float = 0.0
    angle: float = 0.0

    def place(self, points: Array) -> Array:
        """`points` (k, 2) [m] of the shape about the origin, turned and shifted to this pose."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]) + (self.x, self.y))

    def local(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """The points (x, y) [m] in the shape's own axes: the inverse of `place`."""
        dx, dy = np.asarray(x, float) - self.x, np.asarray(y, float) - self.y
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        return cos * dx + sin * dy, cos * dy - sin * dx


@dataclass(frozen=True)
class Circle:
    """A disc of `radius` [m]."""

    radius: float
    pose: Pose = Pose()

    def rim(self) -> Array:
        """Corners (RIM_POINTS, 2) [m] of a regular polygon drawn around the disc."""
        phi = 2 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        radius = self.radius / np.cos(np.pi / RIM_POINTS)
        return self.pose.place(radius * np.stack([np.cos(phi), np.sin(phi)], axis=-1))

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside."""
        return np.asarray(np.hypot(*self.pose.local(x, y)) < self.radius)

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Distance [m] of the points (x, y) [m] from the disc; 0 inside."""
        return np.maximum(np.hypot(*self.pose.local(x, y)) - self.radius, 0.0)


@dataclass(frozen=True)
class Ellipse:
    """An ellipse with semi-axis `a` [m] along its pose's angle and `b` [m] across."""

    a: float
    b: float
    pose: Pose = Pose()

    def rim(self) -> Array:
        """Corners (RIM_POINTS, 2) [m] of a polygon drawn around the ellipse."""
        return self.pose.place(Circle(1.0).rim() * (self.a, self.b))

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside."""
        along, across = self.pose.local(x, y)
        return np.asarray((along / self.a) ** 2 + (across / self.b) ** 2 < 1)


@dataclass(frozen=True)
class Ring:
    """The region between two concentric circles of radius `inner` and `outer` [m]."""

    outer: float
    inner: float
    pose: Pose = Pose()

    def rim(self) -> Array:
        """Corners (RIM_POINTS, 2) [m] of a regular polygon drawn around the outer circle."""
        return Circle(self.outer, self.pose).rim()

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie between the circles."""
        radius = np.hypot(*self.pose.local(x, y))
        return np.asarray((radius < self.outer) & (radius >= self.inner))


@dataclass(frozen=True)
class Polygonal:
    """A simple polygon; `corners` [m] are counter-clockwise about the pose's centre."""

    corners: tuple[tuple[float, float], ...]
    pose: Pose = Pose()

    @cached_property
    def polygon(self) -> Polygon:
        """The polygon where it lies."""
        placed = self.pose.place(np.array(self.corners))
        return Polygon(tuple((float(x), float(y)) for x, y in placed))

    def rim(self) -> Array:
        """The corners and RIM_POINTS points (k, 2) [m] between them."""
        outline = self.polygon
        between = outline.perimeter * np.arange(RIM_POINTS) / RIM_POINTS
        return np.concatenate([np.array(outline.vertices), outline.point(between)])

    def contains(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.bool_]:
        """True where the points (x, y) [m] lie inside."""
        return self.polygon.contains(x, y)

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Distance [m] of the points (x, y) [m] from the polygon; 0 inside."""
        points = np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float)), axis=-1)
        corners = np.array(self.polygon.vertices)
        nearest = np.full(points.shape[:-1], np.inf)
        for start, side in zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True):
            # Foot of the perpendicular on this side, or the side's nearer end.
            along = np.clip((points - start) @ side / (side @ side), 0.0, 1.0)
            nearest = np.minimum(
                nearest, np.linalg.norm(points - start - along[..., None] * side, axis=-1)
            )
        return np.where(self.contains(x, y), 0.0, nearest)


Region = Circle | Ellipse | Ring | Polygonal
"""A shape somewhere on the sensor."""
Indenter = Circle | Polygonal
"""What can press on the foam: regions that know how far from them a point lies."""
