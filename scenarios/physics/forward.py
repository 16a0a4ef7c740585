"""The exact forward model: conductivity to voltages, and its derivative.

With A = K(sigma) + M the stiffness plus the electrodes' mass matrix, B the coupling of nodes and
electrodes and D the electrodes' conductances (see `elements`), the discrete system is

    [  A   -B ] [u]   [0]
    [ -B^T  D ] [U] = [I].

Eliminating u = A^-1 B U leaves the E x E electrode conductance S = D - B^T A^-1 B, whose inverse on
currents that add up to 0 is the electrode resistance R. Every voltage is a sum of four entries of
R, so that one elimination of the nodes (see `dissection`) serves every drive pair.

The derivative. S depends on sigma through A alone: dS = B^T A^-1 dK A^-1 B, hence dR = -R dS R. Let
Y = A^-1 B R, the potentials of unit currents through the electrodes; on one element, Y_e, of matrix
K_e at 1 S/m,

    dR = -sum_e dsigma_e Y_e^T K_e Y_e.

This is the adjoint formula (Geselowitz 1971; Lehr 1972): the adjoint field of a measuring pair is a
combination of the same Y, because R is symmetric (reciprocity), so that no second solve is needed.
The fields Y come from substituting the electrodes' potentials R back into the elimination. For a
scalar L with dL = <G, dR>, G symmetric,

    dL / dsigma_e = -<G, Y_e^T K_e Y_e>.
"""

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.dissection import dissect
from eitbench.scenarios.physics.elements import couplings, electrode_terms
from eitbench.scenarios.physics.elimination import element_gradients, sensitivities, solve
from eitbench.scenarios.physics.mesh import Mesh, build_mesh
from eitbench.scenarios.physics.side_by_side import gradients_together, solve_together
from eitbench.scenarios.physics.tiles import Layout, layout
from eitbench.scenarios.sensors.sensor import Sensor


class ForwardModel:
    """Finite elements with the complete electrode model on one mesh of one sensor.

    From eight images on each takes a quarter of the time that one image takes. They are solved in
    another order: voltages, fields and gradients of an image on its own and of the same image in a
    batch differ by rounding, relatively about 1e-13. What is beside it in the batch, and where,
    changes no bit. Simulated data are solved image by image.

    Attributes:
        sensor: what is simulated; images have its grid.
        mesh: the discretisation.
    """

    def __init__(self, sensor: Sensor, mesh: Mesh | None = None) -> None:
        self.sensor = sensor
        self.mesh = build_mesh(sensor) if mesh is None else mesh
        terms = electrode_terms(self.mesh, sensor.electrodes, sensor.outline.perimeter)
        self._conductance = terms.conductance
        self._parts = dissect(self.mesh, terms)
        self._corners, self._couplings = couplings(self.mesh)

    def voltages(self, sigma: ArrayLike) -> Array:
        """Voltages (..., M) [V/A] of conductivities `sigma` (..., H, W) [S/m].

        Raises:
            InputError: a wrong image shape, or a pixel that is not finite and positive.
        """
        voltages, _ = self._solve(checked_images(self.sensor, sigma), fields=False)
        return voltages.reshape(*np.shape(sigma)[:-2], self.sensor.n_measurements)

    def voltages_and_fields(self, sigma: ArrayLike) -> tuple[Array, Array]:
        """Voltages (n, M) [V/A] of images (n, H, W) [S/m] and the fields that `pullback` needs.

        The fields (n, nodes + E, E) [V/A] are the potentials of unit currents through every
        electrode, against the electrodes' mean; the last E rows are the electrodes'. They take
        0.8 MB an image of 80 x 80 pixels.
        """
        return self._solve(checked_images(self.sensor, sigma), fields=True)

    def pullback(self, fields: Array, cotangent: ArrayLike) -> Array:
        """J^T g (n, H, W) for a cotangent g (n, M), from the fields of n images.

        It is the gradient of sum(g * voltages) with respect to sigma, by the adjoint formula in
        this module's description.
        """
        weights = np.asarray(cotangent, dtype=np.float64)
        resistance = fields[:, len(self.mesh.nodes) :]
        if self.sensor.pattern.magnitudes:
            weights = weights * np.sign(self._signed(resistance))
        # dL = <g, dV> = <G, dR>.
        g = np.ascontiguousarray((self._differences.T @ weights.T).T).reshape(resistance.shape)
        gradient = np.empty((len(weights), len(self.mesh.elements)))
        differentiate = element_gradients if len(weights) == 1 else gradients_together
        differentiate(fields, g, self._corners, self._couplings, gradient)
        return self._per_pixel(gradient).reshape(-1, *self.sensor.image_shape)

    def jacobian(self, sigma: ArrayLike) -> Array:
        """dV/dsigma (M, H, W) [V/A per S/m] at `sigma` (H, W) [S/m], by the adjoint formula."""
        return self.linearise(sigma)[1]

    def linearise(
        self, sigma: ArrayLike, rows: NDArray[np.intp] | slice = slice(None)
    ) -> tuple[Array, Array]:
        """Voltages (M,) and Jacobian (M, H, W) at one image (H, W), from one elimination.

        Of the Jacobian only the given `rows` are worked out and returned; all by default.

        Raises:
            InputError: `sigma` is not one image of the sensor, or not positive and finite inside.
        """
        if np.ndim(sigma) != 2:
            raise InputError(
                f"A Jacobian belongs to one image (H, W), got shape {np.shape(sigma)}."
            )
        voltages, fields = self.voltages_and_fields(np.asarray(sigma)[None])
        wanted = self.sensor.pattern.table[rows]
        per_element = np.empty((len(wanted), len(self.mesh.elements)))
        drives, senses = np.ascontiguousarray(wanted.reshape(-1, 2, 2).swapaxes(0, 1))
        sensitivities(fields[0], drives, senses, self._corners, self._couplings, per_element)
        jacobian = self._per_pixel(per_element)
        if self.sensor.pattern.magnitudes:
            # d|V| = sign(V) dV
            signed = self._signed(fields[:, len(self.mesh.nodes) :])[0]
            jacobian = np.sign(signed[rows])[:, None] * jacobian
        return voltages[0], jacobian.reshape(-1, *self.sensor.image_shape)

    def _per_pixel(self, per_element: Array) -> Array:
        """Derivatives (n, H * W) by pixels from derivatives (n, k) by elements."""
        shares = self.mesh.pixel_shares
        return per_element if shares is None else np.ascontiguousarray((shares.T @ per_element.T).T)

    @cached_property
    def _differences(self) -> sparse.csr_array:
        """(M, E * E): V = differences @ R, symmetric in the indices of R.

        Sparse, so that a sum of one image is taken alike whatever images are beside it: BLAS does
        not promise that.
        """
        return sparse.csr_array(difference_map(self.sensor.pattern.table, self.sensor.n_electrodes))

    @cached_property
    def _layout(self) -> Layout:
        return layout(self._parts)

    @cached_property
    def background(self) -> Array:
        """The homogeneous image (H, W) [S/m] of the untouched sensor; read-only: copy it."""
        image = np.full(self.sensor.image_shape, self.sensor.background)
        image.setflags(write=False)  # models are shared, and all rest on it
        return image

    def _solve(self, images: Array, *, fields: bool) -> tuple[Array, Array]:
        """Voltages (n, M) [V/A] as the board measures them, and the fields if asked for."""
        sigma = images.reshape(len(images), images.shape[1] * images.shape[2])
        shares = self.mesh.pixel_shares
        if shares is not None:
            sigma = np.ascontiguousarray((shares @ sigma.T).T)
        electrodes = self.sensor.n_electrodes
        resistance = np.empty((len(images), electrodes, electrodes))
        kept = np.empty(
            (len(images) if fields else 0, len(self.mesh.nodes) + electrodes, electrodes)
        )
        unknowns = self._conductance, resistance, kept
        if len(sigma) > 1:
            failed = solve_together(sigma, self._parts, self._layout, *unknowns)
        else:
            failed = solve(sigma, self._parts, *unknowns)
        if failed >= 0:
            raise InputError(
                f"The conductivity of image {failed} cannot be solved in double precision: its "
                "pixels, and the electrodes' contact, are too many orders of magnitude apart."
            )
        voltages = self._signed(resistance)
        return np.abs(voltages) if self.sensor.pattern.magnitudes else voltages, kept

    def _signed(self, resistance: Array) -> Array:
        return signed_voltages(self.sensor.pattern.table, resistance)


def checked_images(sensor: Sensor, sigma: ArrayLike) -> Array:
    """Images (n, H, W) [S/m] of a sensor, of one or more; beside the sensor they are untouched.

    Raises:
        InputError: they have another shape, or are not finite and above 0 S/m on the sensor.
    """
    images = np.asarray(sigma, dtype=np.float64)
    shape = sensor.image_shape
    if images.ndim < 2 or images.shape[-2:] != shape:
        raise InputError(
            f"Conductivity for {sensor.name!r} needs shape (..., {shape[0]}, {shape[1]}), "
            f"got {images.shape}."
        )
    images = images.reshape(-1, *shape)
    everywhere = sensor.mask.all()
    inside = images if everywhere else images[:, sensor.mask]
    if not (np.isfinite(inside).all() and (inside > 0).all()):
        raise InputError("Conductivity must be finite and above 0 S/m in every pixel.")
    return images if everywhere else np.where(sensor.mask, images, sensor.background)


def difference_map(table: NDArray[np.int64], electrodes: int) -> Array:
    """(M, E * E): V = map @ R for a table (M, 4) of rows, symmetric in the indices of R."""
    src, sink, a, b = table.T
    maps = np.zeros((len(src), electrodes, electrodes))
    row = np.arange(len(src))
    for i, j, sign in ((a, src, 0.5), (b, src, -0.5), (a, sink, -0.5), (b, sink, 0.5)):
        np.add.at(maps, (row, i, j), sign)
        np.add.at(maps, (row, j, i), sign)
    return maps.reshape(len(src), -1)


def signed_voltages(table: NDArray[np.int64], resistance: Array) -> Array:
    """Signed voltages [V/A] of rows src, sink, a, b from electrode resistances.

    Of a table (M, 4) and resistances (..., E, E), or of tables (..., M, 4) and (E, E), they are
    (..., M).
    """
    src, sink, a, b = np.moveaxis(table, -1, 0)
    return np.asarray(
        resistance[..., a, src]
        - resistance[..., b, src]
        - resistance[..., a, sink]
        + resistance[..., b, sink]
    )


@lru_cache(maxsize=16)
def forward_model(sensor: Sensor) -> ForwardModel:
    """The exact forward model of `sensor` on its image grid; equal sensors share one model."""
    return ForwardModel(sensor)
