"""A three-dimensional slab, whose electrodes may be lower than it is thick.

The conductivity of an image holds through the whole depth. With trilinear elements, the product of
the bilinear ones of the image grid and of linear ones across the depth, every matrix is a Kronecker
product of the plane's and the depth's: with K and M for stiffness and mass,

    K_3D = K_plane x M_depth + M_plane x K_depth,

and the boundary terms are those of the plane times integrals over the height of the electrodes.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.elements import electrode_terms, stiffness
from eitbench.scenarios.physics.forward import checked_images, signed_voltages
from eitbench.scenarios.physics.mesh import Mesh, grid_mesh
from eitbench.scenarios.sensors.outlines import is_rectangle
from eitbench.scenarios.sensors.sensor import Sensor


@dataclass(frozen=True)
class Depth:
    """The depth of a slab.

    Attributes:
        thickness_m: of the slab [m].
        electrode: lower and upper end of the electrodes, as shares of the thickness.
        layers: elements across the depth; the ends of electrodes lie between two of them.
    """

    thickness_m: float
    electrode: tuple[float, float]
    layers: int

    def __post_init__(self) -> None:
        ends = np.multiply(self.electrode, self.layers)
        if not (0 <= ends[0] < ends[1] <= self.layers and np.allclose(ends, np.round(ends))):
            raise InputError(
                f"Electrodes of a slab of {self.layers} layers end between two of them; "
                f"{self.electrode} of its thickness does not."
            )

    @property
    def _step(self) -> float:
        return self.thickness_m / self.layers

    def stiffness(self) -> Array:
        """int N_i' N_j' over the depth (layers + 1, layers + 1) [1/m]."""
        return self._assembled(np.array([[1.0, -1.0], [-1.0, 1.0]]) / self._step, (0.0, 1.0))

    def mass(self, ends: tuple[float, float] = (0.0, 1.0)) -> Array:
        """int N_i N_j between two `ends`, shares of the thickness (layers + 1, layers + 1) [m]."""
        return self._assembled(np.array([[2.0, 1.0], [1.0, 2.0]]) * self._step / 6, ends)

    def _assembled(self, local: Array, ends: tuple[float, float]) -> Array:
        found = np.zeros((self.layers + 1, self.layers + 1))
        first, last = (round(end * self.layers) for end in ends)
        for layer in range(first, last):
            found[layer : layer + 2, layer : layer + 2] += local
        return found


SLAB = Depth(thickness_m=0.01, electrode=(0.0, 0.5), layers=4)
"""A foam of 1 cm whose electrodes reach from its base to half of its height."""


class SlabModel:
    """Finite elements with the complete electrode model on a slab of constant thickness.

    Attributes:
        sensor: what is simulated: a rectangle, whose images have its grid.
    """

    def __init__(self, sensor: Sensor, depth: Depth = SLAB) -> None:
        """Raise InputError for a sensor that is no rectangle."""
        if not is_rectangle(sensor.outline):
            raise InputError(f"A slab is a rectangle, and sensor {sensor.name!r} is none.")
        self.sensor = sensor
        self._depth = depth
        self._mesh = grid_mesh(sensor)
        terms = electrode_terms(self._mesh, sensor.electrodes, sensor.outline.perimeter)
        height = depth.mass(depth.electrode)
        self._electrodes = sparse.kron(terms.mass, height)
        self._coupling = np.kron(terms.coupling, height.sum(axis=1)[:, None])
        self._conductance = terms.conductance * height.sum()

    @cached_property
    def background(self) -> Array:
        """The homogeneous image (H, W) [S/m] of the untouched sensor."""
        return np.full(self.sensor.image_shape, self.sensor.background)

    def voltages(self, sigma: ArrayLike) -> Array:
        """Voltages (M,) [V/A] of one image (H, W) [S/m], times the thickness [m].

        They are those of a sheet of the same conductance, so that the plane's model is comparable.

        Raises:
            InputError: no image of the sensor, see `checked_images`.
        """
        (image,) = checked_images(self.sensor, sigma)
        values = image.ravel()
        plane, across = _plane(self._mesh, values), _plane(self._mesh, values, mass=True)
        system = sparse.kron(plane, self._depth.mass()) + sparse.kron(
            across, self._depth.stiffness()
        )
        solver = sparse.linalg.splu(
            sparse.csc_array(system + self._electrodes),
            permc_spec="MMD_AT_PLUS_A",
            options={"SymmetricMode": True},
        )
        schur = np.diag(self._conductance) - self._coupling.T @ solver.solve(self._coupling)
        # Only currents that add up to 0 flow: the constant that is added meets none of them.
        resistance = np.linalg.inv(schur + schur.max() / len(schur))
        voltages = signed_voltages(self.sensor.pattern.table, resistance) * self._depth.thickness_m
        return np.abs(voltages) if self.sensor.pattern.magnitudes else voltages


def _plane(mesh: Mesh, sigma: Array, *, mass: bool = False) -> sparse.csr_array:
    """The stiffness or mass matrix (n, n) of the plane, of elements weighted by `sigma` (k,)."""
    corners = mesh.elements
    local = _mass(mesh) if mass else stiffness(mesh)
    rows, columns = np.repeat(corners, 4, axis=1), np.tile(corners, (1, 4))
    values = (sigma[:, None, None] * local).reshape(len(corners), -1)
    shape = (len(mesh.nodes), len(mesh.nodes))
    return sparse.csr_array(
        sparse.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    )


def _mass(mesh: Mesh) -> Array:
    """int N_i N_j over each pixel (k, 4, 4) [m^2], corners counter-clockwise."""
    corners = mesh.nodes[mesh.elements]
    area = np.prod(corners[:, 2] - corners[:, 0], axis=1)
    shares = np.array([[4.0, 2, 1, 2], [2, 4, 2, 1], [1, 2, 4, 2], [2, 1, 2, 4]]) / 36
    return np.asarray(area[:, None, None] * shares)
