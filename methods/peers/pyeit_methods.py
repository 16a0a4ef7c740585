"""pyEIT's JAC, GREIT and BP, run by pyEIT on its own mesh with its own point electrodes.

pyEIT has no complete electrode model: a current enters at one node, and the potential of that node
is what an electrode measures. Coordinates are centred and scaled so that the sensor's longer half
side is 1, as pyEIT's mesh generator expects; potentials in two dimensions do not depend on scale.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from eitbench.methods.peers.peer import Peer, interpolation, pixels_inside
from eitbench.methods.registry import register
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.outlines import Disc, Outline, Polygon
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

    from eitbench.methods.problem import Problem
    from eitbench.scenarios.sensors.patterns import DrivePattern
    from eitbench.scenarios.sensors.sensor import Sensor


# pyEIT's default distance between nodes, of half the sensor's longer side.
NODE_DISTANCE = 0.1
SAME_POINT = 1e-6


def scaled(outline: Outline, points: Array) -> Array:
    """`points` (..., 2) [m] centred on the outline's bounding box; its longer half side is 1."""
    return np.asarray((points - outline.centre) * (2 / outline.longer_side))


def signed_distance(outline: Outline, points: Array) -> Array:
    """Distance (p,) from scaled `points` (p, 2) to the rim, negative inside.

    Raises:
        InputError: an outline that is neither a disc nor a polygon.
    """
    if isinstance(outline, Disc):
        return np.asarray(np.hypot(points[:, 0], points[:, 1]) - 1)
    if not isinstance(outline, Polygon):
        raise InputError("pyEIT's meshes are made of discs and polygons only.")
    corners = scaled(outline, np.array(outline.vertices))
    sides = np.roll(corners, -1, axis=0) - corners
    offset = points[:, None] - corners
    along = np.clip(np.sum(offset * sides, axis=-1) / np.sum(sides**2, axis=-1), 0, 1)
    distance = np.linalg.norm(offset - along[..., None] * sides, axis=-1).min(axis=1)
    unit = Polygon(tuple((float(x), float(y)) for x, y in corners))
    return np.asarray(np.where(unit.contains(*points.T), -distance, distance))


@lru_cache(maxsize=8)
def pyeit_mesh(sensor: Sensor) -> PyEITMesh:
    """pyEIT's mesh of the sensor at 1 S/m; electrode k is node k, at the electrode's centre."""
    from pyeit.mesh import create

    outline = sensor.outline
    fixed = scaled(outline, outline.point(np.array([e.centre for e in sensor.electrodes])))
    for corner in scaled(outline, outline.point(outline.corners)):
        if np.linalg.norm(fixed - corner, axis=1).min() > SAME_POINT:
            fixed = np.vstack([fixed, corner])
    x0, y0, x1, y1 = outline.bounds
    box = scaled(outline, np.array([[x0, y0], [x1, y1]]))
    return create(
        n_el=sensor.n_electrodes,
        fd=lambda points: signed_distance(outline, points),
        h0=NODE_DISTANCE,
        p_fix=fixed,
        bbox=box,
    )


def pyeit_protocol(pattern: DrivePattern) -> PyEITProtocol:
    """The drive pattern, measurement by measurement, with our signs and in our order.

    pyEIT wants equally many measurements of every excitation. Runs of rows with the same drive are
    cut into equal parts of the largest size that fits all: a whole run where all are as long.
    """
    from pyeit.eit.protocol import PyEITProtocol

    table = pattern.table
    changes = (np.diff(table[:, :2], axis=0) != 0).any(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], changes, [True]]))
    size = int(np.gcd.reduce(np.diff(starts)))
    return PyEITProtocol(
        ex_mat=np.array(table[::size, :2]),
        meas_mat=np.array(table[:, 2:]).reshape(-1, size, 2),
        keep_ba=np.ones(len(table), dtype=bool),
    )


DIFFERS = "run by pyEIT with point electrodes on a mesh of its own"
UNEVEN = "pyEIT's triangles are not symmetric"
Solve = Callable[[Array, Array], Array]
LAMBDAS = (1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0)


class PyEit(Peer):
    """Base of pyEIT's methods; a subclass says which solver it sets up."""

    source: ClassVar[str] = "Liu et al. (pyEIT), SoftwareX 7, 2018"
    needs: ClassVar = "pyeit"
    differs = DIFFERS

    def prepare(self, problem: Problem) -> None:
        """Make pyEIT's mesh, and the solver on it."""
        sensor = problem.sensor
        mesh = pyeit_mesh(sensor)
        self.differs = f"{DIFFERS} ({mesh.n_elems} triangles)"
        self._solve, points = self.solver(mesh, pyeit_protocol(sensor.pattern))
        self._to_pixels = interpolation(points, scaled(sensor.outline, pixels_inside(problem)))

    @abstractmethod
    def solver(self, mesh: PyEITMesh, protocol: Any) -> tuple[Solve, Array]:
        """pyEIT's `solve` of (n, M) frames, and the points (p, 2) that its solutions belong to."""

    def contrast(self, difference: Array, reference: Array) -> Array:
        """See `Peer`; pyEIT's `solve`."""
        found = np.real(self._solve(reference + difference, reference))
        return np.asarray((self._to_pixels @ found).T)


@register("pyeit-jac")
@dataclass
class PyEitJac(PyEit):
    """pyEIT's JAC: one Gauss-Newton step on its own mesh.

    Attributes:
        p: exponent of the prior diag(J^T J)^p, of method "kotre".
        lamb: regularisation.
        method: the prior: "kotre", "lm" (p = 1) or "dgn" (p = 0).
        normalize: differences relative to the reference frame.
        log_scale: the estimate is taken as the logarithm of relative conductivity.
    """

    expected_failures: ClassVar = asymmetry(UNEVEN)
    search: ClassVar = {
        "lamb": LAMBDAS,
        "normalize": (False, True),
        "p": (0.2, 0.5, 0.8),
        "method": ("kotre", "lm", "dgn"),
        "log_scale": (False, True),
    }
    p: float = 0.5
    lamb: float = 0.01
    method: str = "kotre"
    normalize: bool = True
    log_scale: bool = False

    def solver(self, mesh: PyEITMesh, protocol: Any) -> tuple[Solve, Array]:
        """`pyeit.eit.jac.JAC`, which estimates elements."""
        from pyeit.eit.jac import JAC

        solver = JAC(mesh, protocol)
        solver.setup(
            p=self.p, lamb=self.lamb, method=self.method, perm=1.0, jac_normalized=self.normalize
        )
        solve = partial(solver.solve, normalize=self.normalize, log_scale=self.log_scale)
        return solve, mesh.elem_centers[:, :2]


@register("pyeit-greit")
@dataclass
class PyEitGreit(PyEit):
    """pyEIT's GREIT ("dist"): sigmoid-blurred sensitivities on a 32 x 32 grid.

    Attributes:
        lamb, p: strength and exponent of the noise covariance diag(J J^T)^p.
        s: steepness of the desired image's rim.
        ratio: its radius, as a fraction of the sensor's greatest extent.
        normalize: differences relative to the reference frame.
    """

    expected_failures: ClassVar = asymmetry(UNEVEN)
    search: ClassVar = {
        "lamb": LAMBDAS,
        "normalize": (False, True),
        "ratio": (0.03, 0.05, 0.1, 0.2),
        "p": (0.2, 0.5, 1.0),
        "s": (10.0, 20.0, 40.0),
    }
    lamb: float = 0.01
    p: float = 0.2
    s: float = 20.0
    ratio: float = 0.1
    normalize: bool = True

    def solver(self, mesh: PyEITMesh, protocol: Any) -> tuple[Solve, Array]:
        """`pyeit.eit.greit.GREIT`, which estimates points of a grid."""
        from pyeit.eit.greit import GREIT

        solver = GREIT(mesh, protocol)
        solver.setup(
            method="dist", p=self.p, lamb=self.lamb, s=self.s, ratio=self.ratio, perm=1.0,
            jac_normalized=self.normalize,
        )  # fmt: skip
        x, y, outside = solver.get_grid()
        points = np.column_stack([x.ravel(), y.ravel()])[~outside]
        return lambda *frames: solver.solve(*frames, normalize=self.normalize)[~outside], points


@register("pyeit-bp")
@dataclass
class PyEitBp(PyEit):
    """pyEIT's BP: naive back-projection between equipotential lines.

    Attributes:
        weight: "simple" weakens the rim, "none" does not.
    """

    expected_failures: ClassVar = asymmetry(UNEVEN)
    search: ClassVar = {"weight": ("none", "simple")}
    weight: str = "none"

    def solver(self, mesh: PyEITMesh, protocol: Any) -> tuple[Solve, Array]:
        """`pyeit.eit.bp.BP`, which estimates nodes."""
        from pyeit.eit.bp import BP

        solver = BP(mesh, protocol)
        solver.setup(weight=self.weight, perm=1.0)
        return partial(solver.solve, normalize=True), mesh.node[:, :2]
