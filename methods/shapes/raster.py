"""Images of shapes: a few regions of one conductivity each, with soft or sharp edges.

A level is blended into an image by the share s of each pixel that lies in the region. The share
falls from 1 to 0 over the width `edge` [m] across the rim; with 0 it is 1 where the centre of the
pixel lies inside, as in the images of phantoms. A pixel becomes level^s image^(1-s): in two
dimensions the geometric mean is what a random mixture conducts (Keller 1964; Dykhne 1971), and an
edge of whole pixels is one.
"""

from typing import NamedTuple

import numpy as np

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.sensors.sensor import Sensor


class Grid(NamedTuple):
    """Centre of the first pixel (x, y) and size of pixels (width, height) [m]."""

    x: float
    y: float
    width: float
    height: float


def pixel_grid(sensor: Sensor) -> Grid:
    """The grid of a sensor's images."""
    x, y = sensor.pixel_centres
    return Grid(float(x[0, 0]), float(y[0, 0]), *sensor.pixel_size)


@compiled
def _blended(before: float, level: float, distance: float, edge: float) -> float:
    """What a pixel becomes at a signed distance [m] from the rim, negative inside."""
    if distance < -edge / 2:
        return level
    if distance >= edge / 2:
        return before
    return float(before * (level / before) ** (0.5 - distance / edge))


@compiled
def _window(low: float, high: float, first: float, size: float, count: int) -> tuple[int, int]:
    """Numbers [begin, end) of the pixels whose centres may lie between two coordinates [m]."""
    begin = int(np.floor((low - first) / size))
    end = int(np.ceil((high - first) / size)) + 1
    return max(begin, 0), min(end, count)


@compiled
def paint_rings(
    images: Array,
    places: Array,
    inner: Array,
    outer: Array,
    levels: Array,
    grid: Grid,
    edge: float,
) -> None:
    """Blend levels (n,) into images (n, H, W), in rings about places (n, 2) of these radii (n,).

    All lengths are in metres; a ring of inner radius 0 is a disc.
    """
    for n in range(len(images)):
        _paint_ring(
            images[n], places[n, 0], places[n, 1], inner[n], outer[n], levels[n], grid, edge
        )


@compiled
def paint_polygons(images: Array, corners: Array, levels: Array, grid: Grid, edge: float) -> None:
    """Blend levels (n,) into images (n, H, W), in polygons of corners (n, k, 2) [m]."""
    for n in range(len(images)):
        _paint_polygon(images[n], corners[n], levels[n], grid, edge)


@compiled
def _paint_ring(
    image: Array,
    x: float,
    y: float,
    inner: float,
    outer: float,
    level: float,
    grid: Grid,
    edge: float,
) -> None:
    reach = outer + edge
    left, right = _window(x - reach, x + reach, grid.x, grid.width, image.shape[1])
    bottom, top = _window(y - reach, y + reach, grid.y, grid.height, image.shape[0])
    for row in range(bottom, top):
        dy = grid.y + row * grid.height - y
        for column in range(left, right):
            dx = grid.x + column * grid.width - x
            radius = np.sqrt(dx * dx + dy * dy)
            distance = max(radius - outer, inner - radius) if inner > 0.0 else radius - outer
            image[row, column] = _blended(image[row, column], level, distance, edge)


@compiled
def _paint_polygon(image: Array, corners: Array, level: float, grid: Grid, edge: float) -> None:
    count = len(corners)
    left, right = _window(
        corners[:, 0].min() - edge, corners[:, 0].max() + edge, grid.x, grid.width, image.shape[1]
    )
    bottom, top = _window(
        corners[:, 1].min() - edge, corners[:, 1].max() + edge, grid.y, grid.height, image.shape[0]
    )
    for row in range(bottom, top):
        y = grid.y + row * grid.height
        for column in range(left, right):
            x = grid.x + column * grid.width
            nearest, inside = np.inf, False
            for k in range(count):
                x0, y0 = corners[k, 0], corners[k, 1]
                x1, y1 = corners[(k + 1) % count, 0], corners[(k + 1) % count, 1]
                ex, ey, px, py = x1 - x0, y1 - y0, x - x0, y - y0
                # A ray to the right crosses the sides that pass its height.
                if (y0 <= y) != (y1 <= y) and px < ex * py / ey:
                    inside = not inside
                if edge > 0.0:  # a sharp edge asks for the side alone
                    along = min(max((px * ex + py * ey) / (ex * ex + ey * ey), 0.0), 1.0)
                    px, py = px - along * ex, py - along * ey
                    nearest = min(nearest, px * px + py * py)
            distance = -np.sqrt(nearest) if inside else np.sqrt(nearest)
            image[row, column] = _blended(image[row, column], level, distance, edge)
