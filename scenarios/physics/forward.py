"""The exact forward model: conductivity to voltages, and its derivative.

With A = K(sigma) + M the stiffness plus the electrodes' mass matrix, B the coupling of nodes and
electrodes and D the electrodes' conductances (see `elements`), the discrete system is

    [  A   -B ] [u]   [0]
    [ -B^T  D ] [U] = [I].

Eliminating u = A^-1 B U leaves the E x E electrode conductance S = D - B^T A^-1 B, so one Cholesky
factorisation of A and E right-hand sides (the columns of B) serve every drive pair.
"""

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.elements import ElectrodeTerms, electrode_terms, stiffness
from eitbench.scenarios.physics.mesh import Mesh, build_mesh
from eitbench.scenarios.sensors import Sensor

Array = NDArray[np.float64]


class ForwardModel:
    """Finite elements with the complete electrode model on one mesh of one sensor.

    Attributes:
        sensor: what is simulated; images have its grid.
        mesh: the discretisation.
    """

    def __init__(self, sensor: Sensor, mesh: Mesh | None = None) -> None:
        self.sensor = sensor
        self.mesh = build_mesh(sensor) if mesh is None else mesh
        self._terms: ElectrodeTerms = electrode_terms(
            self.mesh, sensor.electrodes, sensor.outline.perimeter
        )
        self._stiffness = stiffness(self.mesh)
        self._threads = ThreadpoolController()
        self._assembly, self._electrode_band = self._band_assembly()

    @property
    def mesh_hash(self) -> str:
        """SHA-256 (hex) of the mesh."""
        return self.mesh.content_hash

    @property
    def n_elements(self) -> int:
        """Number of finite elements."""
        return len(self.mesh.elements)

    def voltages(self, sigma: ArrayLike) -> Array:
        """Voltages (..., M) [V/A] of conductivities `sigma` (..., H, W) [S/m].

        Raises:
            InputError: a wrong image shape, or a pixel that is not finite and positive.
        """
        images = self._checked(sigma)
        frames = np.empty((len(images), self.sensor.n_measurements))
        for frame, image in zip(frames, images, strict=True):
            frame[:] = self._measured(self._solve(image)[1])
        if self.sensor.pattern.magnitudes:
            frames = np.abs(frames)
        return frames.reshape(*np.shape(sigma)[:-2], self.sensor.n_measurements)

    def jacobian(self, sigma: ArrayLike) -> Array:
        """dV/dsigma (M, H, W) [V/A per S/m] at `sigma` (H, W) [S/m], by the adjoint formula.

        For drive field u and the field w of a unit current through the measuring pair,
        dV = -int dsigma grad u . grad w (Geselowitz 1971; Lehr 1972).

        Raises:
            InputError: a wrong image shape, or a pixel that is not finite and positive.
        """
        return self.linearise(sigma)[1]

    def linearise(self, sigma: ArrayLike) -> tuple[Array, Array]:
        """Voltages (M,) and Jacobian (M, H, W) at one image (H, W), from one factorisation."""
        if np.ndim(sigma) != 2:
            raise InputError(
                f"A Jacobian belongs to one image (H, W), got shape {np.shape(sigma)}."
            )
        potential, resistance = self._solve(self._checked(sigma)[0])
        voltages = self._measured(resistance)
        per_element = self._sensitivity(potential @ resistance)
        shares = self.mesh.pixel_shares
        jacobian = per_element if shares is None else (shares.T @ per_element.T).T
        if self.sensor.pattern.magnitudes:
            # d|V| = sign(V) dV
            jacobian = np.sign(voltages)[:, None] * jacobian
            voltages = np.abs(voltages)
        return voltages, np.ascontiguousarray(jacobian).reshape(-1, *self.sensor.image_shape)

    def _sensitivity(self, fields: Array) -> Array:
        """dV/dsigma (M, k) per element from potentials (n, E) of unit electrode currents."""
        src, sink, a, b = self.sensor.pattern.table.T
        drives, drive = np.unique(np.column_stack([src, sink]), axis=0, return_inverse=True)
        senses, sense = np.unique(np.column_stack([a, b]), axis=0, return_inverse=True)
        # Potentials at the c corners of the k elements, for each pair: (pairs, c, k).
        corners = np.ascontiguousarray(fields.T)[:, self.mesh.elements.T]
        u = corners[drives[:, 0]] - corners[drives[:, 1]]
        w = corners[senses[:, 0]] - corners[senses[:, 1]]
        flux = np.zeros_like(u)
        for i, j in np.ndindex(u.shape[1], u.shape[1]):
            flux[:, i] -= self._stiffness[:, i, j] * u[:, j]
        sensitivity = np.empty((len(drive), self.n_elements))
        for m, (d, s) in enumerate(zip(drive, sense, strict=True)):
            np.einsum("ck,ck->k", flux[d], w[s], out=sensitivity[m])
        return sensitivity

    @cached_property
    def background(self) -> Array:
        """The homogeneous image (H, W) [S/m] of the untouched sensor."""
        return np.full(self.sensor.image_shape, self.sensor.background)

    def _checked(self, sigma: ArrayLike) -> Array:
        images = np.asarray(sigma, dtype=np.float64)
        shape = self.sensor.image_shape
        if images.ndim < 2 or images.shape[-2:] != shape:
            raise InputError(
                f"Conductivity for {self.sensor.name!r} needs shape (..., {shape[0]}, {shape[1]}), "
                f"got {images.shape}."
            )
        images = images.reshape(-1, *shape)
        inside = images[:, self.sensor.mask]
        if not (np.isfinite(inside).all() and (inside > 0).all()):
            raise InputError("Conductivity must be finite and above 0 S/m in every pixel.")
        if not self.sensor.mask.all():
            images = np.where(self.sensor.mask, images, self.sensor.background)
        return images

    def _band_assembly(self) -> tuple[sparse.csr_array, Array]:
        """Sparse map from pixels to the band of K(sigma), and the band of M, both flattened.

        The band is LAPACK's lower form in column-major order: A[i, j], i >= j, is entry
        (i - j) + (bandwidth + 1) * j.
        """
        elements, corners = self.mesh.elements, self.mesh.elements.shape[1]
        row = np.repeat(elements, corners, axis=1).ravel()
        column = np.tile(elements, (1, corners)).ravel()
        mass = self._terms.mass.tocoo()
        self._bandwidth = int(max(np.max(row - column), np.max(mass.row - mass.col)))
        depth, n = self._bandwidth + 1, len(self.mesh.nodes)
        lower = row >= column
        element = np.repeat(np.arange(len(elements)), corners**2)
        entry = (row - column) + depth * column
        assembly = sparse.coo_array(
            (self._stiffness.ravel()[lower], (entry[lower], element[lower])),
            shape=(depth * n, len(elements)),
        ).tocsr()
        if self.mesh.pixel_shares is not None:
            assembly = assembly @ self.mesh.pixel_shares
        below = mass.row >= mass.col
        mass_entry = (mass.row - mass.col + depth * mass.col)[below]
        band = np.zeros(depth * n)
        np.add.at(band, mass_entry, mass.data[below])
        return sparse.csr_array(assembly), band

    def _solve(self, image: Array) -> tuple[Array, Array]:
        """A^-1 B (n, E) and the electrode resistance S^+ (E, E) [Ohm] for one `image` (H, W)."""
        band = self._assembly @ image.ravel() + self._electrode_band
        band = band.reshape(-1, self._bandwidth + 1).T
        # Systems this small are slower on several threads, and differ in the last bit.
        with self._threads.limit(limits=1, user_api="blas"):
            _, potential, info = lapack.dpbsv(band, self._terms.coupling, lower=1, overwrite_ab=1)
        if info != 0:
            raise InputError("The conductivity is too uneven to solve: raise its smallest pixels.")
        conductance = np.diag(self._terms.conductance) - self._terms.coupling.T @ potential
        # S has the constants as its kernel; adding them makes it regular and keeps sum(U) = 0.
        resistance = np.linalg.inv(conductance + 1.0 / len(conductance))
        return potential, (resistance + resistance.T) / 2

    def _measured(self, resistance: Array) -> Array:
        """Signed voltages (M,) [V/A] from the electrode resistance (E, E)."""
        src, sink, a, b = self.sensor.pattern.table.T
        return np.asarray(
            resistance[a, src] - resistance[b, src] - resistance[a, sink] + resistance[b, sink]
        )


@lru_cache(maxsize=16)
def forward_model(sensor: Sensor) -> ForwardModel:
    """The exact forward model of `sensor` on its image grid; equal sensors share one model."""
    return ForwardModel(sensor)
