"""Meshes for the forward model: the pixel grid of a rectangle, triangles for any other outline."""

from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from eitbench.scenarios.arrays import Array, Index
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.outlines import Polygon, is_rectangle
from eitbench.scenarios.sensors.sensor import Sensor

# A triangle straddles pixels; its share in each is counted on SUBDIVISION**2 equal sub-triangles.
SUBDIVISION = 4
# The current density is singular at the ends of electrodes: triangles there are this much smaller.
ELECTRODE_END_REFINEMENT = 4
# The mesher answers a change in the last bit of a rim point with another mesh, and sines differ in
# that bit between processors: rim points are multiples of a length [m] that all of them agree on.
RIM_GRID = 2.0**-30


@dataclass(frozen=True, eq=False)
class Mesh:
    """A finite-element mesh of a sensor.

    Attributes:
        nodes: (n, 2) coordinates [m], numbered so that neighbours have close numbers.
        elements: (k, 3) triangles or (k, 4) quadrilaterals as counter-clockwise node numbers.
        rim_edges: (r, 2) node numbers of the edges on the rim, counter-clockwise.
        rim_arcs: (r, 2) arc length [m] of the edges' ends along the outline, increasing.
        rim_electrodes: (r, 2) the electrodes nearest to the ends of each edge of the rim. An
            electrode may lie anywhere on the edges that it is nearest to.
        pixel_shares: (k, H*W) sparse; the fraction of each element that lies in each pixel. None
            where element k is pixel k.
    """

    nodes: Array
    elements: Index
    rim_edges: Index
    rim_arcs: Array
    rim_electrodes: Index
    pixel_shares: sparse.csr_array | None


def mesh_recipe(sensor: Sensor, *, triangles: bool) -> str:
    """What decides the mesh of `sensor` beside the sensor itself: the way it is made."""
    if is_rectangle(sensor.outline) and not triangles:
        return "pixels"
    return f"triangles of netgen {version('netgen-mesher')}"


def build_mesh(sensor: Sensor) -> Mesh:
    """Bilinear elements, one a pixel, where pixels fill the outline; else triangles."""
    return grid_mesh(sensor) if is_rectangle(sensor.outline) else triangle_mesh(sensor)


def grid_mesh(sensor: Sensor) -> Mesh:
    """The pixel grid itself: (H+1)(W+1) nodes, one quadrilateral per pixel."""
    assert isinstance(sensor.outline, Polygon)
    height, width = sensor.image_shape
    x0, y0, x1, y1 = sensor.outline.bounds
    vertices = sensor.outline.vertices
    # Rows are numbered along the shorter side: the bandwidth of the system is that side.
    number = np.arange((height + 1) * (width + 1), dtype=np.int64).reshape(
        height + 1, width + 1, order="C" if width <= height else "F"
    )
    x, y = np.meshgrid(np.linspace(x0, x1, width + 1), np.linspace(y0, y1, height + 1))
    nodes = np.empty((number.size, 2))
    nodes[number.ravel()] = np.column_stack([x.ravel(), y.ravel()])
    corners = (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    elements = np.stack(corners, axis=-1).reshape(-1, 4)
    rim = np.concatenate([number[0], number[1:, -1], number[-1, -2::-1], number[-2::-1, 0]])
    steps = np.hypot(*np.diff(nodes[rim], axis=0).T)
    # Arc length runs from the first vertex of the outline, which may be another corner than this.
    (start,) = sensor.outline.corners[[corner == (x0, y0) for corner in vertices]]
    arc = start + np.concatenate([[0.0], np.cumsum(steps)])
    arcs = np.column_stack([arc[:-1], arc[1:]])
    return Mesh(
        nodes,
        elements,
        np.column_stack([rim[:-1], rim[1:]]),
        arcs,
        _nearest_electrodes(sensor, arcs),
        pixel_shares=None,
    )


MOST_TRIANGLES = 300_000
"""More take minutes to make, and all memory."""


def triangle_mesh(sensor: Sensor) -> Mesh:
    """Unstructured triangles no larger than a pixel, finer at electrode ends (mesher: Netgen).

    Raises:
        InputError: it would have more than `MOST_TRIANGLES`, as pixels are long and thin or many.
    """
    # Imported here: square sensors do not need the mesher.
    from netgen.geom2d import SplineGeometry

    size = min(sensor.pixel_size)
    area = np.count_nonzero(sensor.mask) * np.prod(sensor.pixel_size)
    if (count := area / (np.sqrt(3) / 4 * size**2)) > MOST_TRIANGLES:
        across, along = (1e3 * length for length in sensor.pixel_size)
        raise InputError(
            f"A mesh of sensor {sensor.name!r} would have about {count:,.0f} triangles, as they "
            f"are no larger than the shorter side of its pixels of {across:.3g} x {along:.3g} mm: "
            "give an `image_shape` whose pixels are nearly square, and fewer of them."
        )
    arcs, is_end = _rim_points(sensor, size)
    geometry = SplineGeometry()
    rim = np.round(sensor.outline.point(arcs) / RIM_GRID) * RIM_GRID
    for (x, y), end in zip(rim, is_end, strict=True):
        geometry.AppendPoint(x, y, maxh=size / ELECTRODE_END_REFINEMENT if end else size)
    for k in range(len(arcs)):
        following = (k + 1) % len(arcs)
        geometry.Append(["line", k, following], leftdomain=1, rightdomain=0, bc=k + 1)
    made = geometry.GenerateMesh(maxh=size)

    nodes = np.array([point.p[:2] for point in made.Points()])
    triangles = np.array(
        [[v.nr - 1 for v in e.vertices] for e in made.Elements2D()], dtype=np.int64
    )
    edges = np.array([[v.nr - 1 for v in e.vertices] for e in made.Elements1D()], dtype=np.int64)
    side = np.array([e.index - 1 for e in made.Elements1D()], dtype=np.int64)

    rim_arcs = _arc_lengths(nodes[edges], side, arcs, rim, sensor.outline.perimeter)
    backwards = rim_arcs[:, 0] > rim_arcs[:, 1]
    edges[backwards] = edges[backwards, ::-1]
    rim_arcs[backwards] = rim_arcs[backwards, ::-1]

    nodes, triangles, edges = _renumbered(nodes, triangles, edges)
    shares = _pixel_shares(nodes, triangles, sensor)
    return Mesh(nodes, triangles, edges, rim_arcs, _nearest_electrodes(sensor, rim_arcs), shares)


def _nearest_electrodes(sensor: Sensor, arcs: Array) -> Index:
    """The electrode whose end is nearest along the rim to each of the `arcs` (...) [m]."""
    perimeter = sensor.outline.perimeter
    centres, widths = np.array([(e.centre, e.width) for e in sensor.electrodes]).T
    apart = (arcs[..., None] - centres) % perimeter
    apart = np.minimum(apart, perimeter - apart) - (widths - widths.min()) / 2
    return np.asarray(apart.argmin(axis=-1), dtype=np.int64)


def _rim_points(sensor: Sensor, size: float) -> tuple[Array, NDArray[np.bool_]]:
    """Arc lengths (p,) [m] of rim points at most `size` apart, and which are electrode ends."""
    perimeter = sensor.outline.perimeter
    ends = np.array([e.centre + sign * e.width / 2 for e in sensor.electrodes for sign in (-1, 1)])
    keys = np.concatenate([ends % perimeter, sensor.outline.corners])
    is_end = np.arange(len(keys)) < len(ends)
    order = np.argsort(keys, kind="stable")
    keys, is_end = keys[order], is_end[order]
    # Points that coincide are one, also the last and the first, which lie on either side of s = 0.
    nearest = 1e-9 * perimeter
    distinct = np.concatenate([[True], np.diff(keys) > nearest])
    point = np.cumsum(distinct) - 1
    if keys[0] + perimeter - keys[-1] <= nearest:
        point[point == point[-1]] = 0
    keys, is_end = keys[distinct][: point.max() + 1], np.bincount(point, is_end) > 0
    arcs, flags = [], []
    for k, start in enumerate(keys):
        gap = (keys[(k + 1) % len(keys)] - start) % perimeter
        pieces = max(1, int(np.ceil(gap / size - 1e-9)))
        arcs.append(start + gap * np.arange(pieces) / pieces)
        flags.append(np.arange(pieces) == 0 if is_end[k] else np.zeros(pieces, dtype=bool))
    return np.concatenate(arcs), np.concatenate(flags)


def _arc_lengths(ends: Array, side: Index, arcs: Array, rim: Array, perimeter: float) -> Array:
    """Arc lengths (r, 2) of rim edges with `ends` (r, 2, 2) on the straight pieces `side` (r,)."""
    start, stop = arcs[side], np.append(arcs[1:], arcs[0] + perimeter)[side]
    origin = rim[side]
    along = np.roll(rim, -1, axis=0)[side] - origin
    fraction = (
        np.einsum("rpx,rx->rp", ends - origin[:, None], along) / np.sum(along**2, axis=1)[:, None]
    )
    return np.asarray(start[:, None] + fraction * (stop - start)[:, None])


def _renumbered(nodes: Array, triangles: Index, edges: Index) -> tuple[Array, Index, Index]:
    """The mesh with nodes in reverse Cuthill-McKee order, which keeps the system's band narrow."""
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    links = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(len(nodes),) * 2).tocsr()
    order = sparse.csgraph.reverse_cuthill_mckee(links + links.T, symmetric_mode=True)
    rank = np.empty(len(nodes), dtype=np.int64)
    rank[order] = np.arange(len(nodes))
    return nodes[order], rank[triangles], rank[edges]


def _pixel_shares(nodes: Array, triangles: Index, sensor: Sensor) -> sparse.csr_array:
    """(k, H*W) share of each triangle in each pixel; beyond the mask, in the nearest one."""
    height, width = sensor.image_shape
    points = np.einsum("qc,kcx->kqx", _sub_centroids(SUBDIVISION), nodes[triangles])
    x0, y0, _, _ = sensor.outline.bounds
    dx, dy = sensor.pixel_size
    column = np.clip(((points[..., 0] - x0) / dx).astype(np.int64), 0, width - 1)
    row = np.clip(((points[..., 1] - y0) / dy).astype(np.int64), 0, height - 1)
    nearest = ndimage.distance_transform_edt(
        ~sensor.mask, return_distances=False, return_indices=True
    )
    pixel = nearest[0, row, column] * width + nearest[1, row, column]
    share = np.full(pixel.size, 1 / SUBDIVISION**2)
    rows = np.repeat(np.arange(len(triangles)), SUBDIVISION**2)
    shape = (len(triangles), height * width)
    return sparse.csr_array(sparse.coo_array((share, (rows, pixel.ravel())), shape=shape))


def _sub_centroids(m: int) -> Array:
    """Barycentric coordinates (m*m, 3) of the centroids of a triangle cut into m*m equal ones."""
    upright = [(3 * i + 1, 3 * j + 1) for i in range(m) for j in range(m - i)]
    inverted = [(3 * i + 2, 3 * j + 2) for i in range(m - 1) for j in range(m - 1 - i)]
    first_two = np.array(upright + inverted) / (3 * m)
    return np.column_stack([first_two, 1 - first_two.sum(axis=1)])
