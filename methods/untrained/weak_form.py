"""The equations that the networks of a PINN are to satisfy: the potentials', and the data's.

Let Y_0 be the potentials of unit currents through every electrode of the untouched sensor at the n
nodes and the E electrodes (`scenarios.physics.forward`), and Y_0 + W those with a touch, which
changes the conductivity by d sigma. Their equations, one minus the other, and without the
electrodes' potentials, which are D^-1 B^T W, leave for W (n, E) at the nodes

    r = (K(sigma) + M - B D^-1 B^T) W + K(d sigma) Y_0 = 0,

the weak form of div(sigma grad w) = -div(d sigma grad u_0) with the complete electrode model,
tested with the function of every node. The electrode resistance changes by exactly

    dR = -Y_0^T K(d sigma) (Y_0 + W),

by Green's identity. With W = 0 this is the linear model, so that data say at once where a touch is.

Source: the pair of equations is that of contrast source inversion (van den Berg and Kleinman,
Inverse Problems 13(6), 1997), here with networks for both unknowns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import splu
from torch import Tensor

from eitbench.scenarios.physics.elements import electrode_terms, stiffness

if TYPE_CHECKING:
    from eitbench.scenarios.arrays import Array
    from eitbench.scenarios.physics.forward import ForwardModel
    from eitbench.scenarios.physics.mesh import Mesh


class WeakForm:
    """The equations of one model, for images (H, W) and secondary potentials (n, E).

    Attributes:
        points: (n, 2) the nodes, from -1 to 1 over the longer side of the sensor.
        scale: root mean square of Y_0 at the nodes [V/A], to measure W in.
    """

    def __init__(self, model: ForwardModel) -> None:
        self._model = model
        sensor, mesh = model.sensor, model.mesh
        self._pattern, self._background = sensor.pattern, sensor.background
        _, fields = model.voltages_and_fields(model.background[None])
        untouched, resistance = np.split(fields[0], [len(mesh.nodes)])
        self._untouched = untouched
        self._resistance = torch.from_numpy(resistance)
        self._shares = None if mesh.pixel_shares is None else Product(mesh.pixel_shares)
        self._elements = torch.from_numpy(mesh.elements)
        self._matrices = torch.from_numpy(stiffness(mesh)).float()
        terms = electrode_terms(mesh, sensor.electrodes, sensor.outline.perimeter)
        stiff = _assembled(mesh, self._background)
        self._gram = splu(sparse.csc_matrix(stiff + terms.mass))
        coupling = sparse.csr_array(terms.coupling)
        eliminated = coupling @ sparse.diags_array(1 / terms.conductance) @ coupling.T
        self._contact = Product(terms.mass - eliminated)
        self._corners = torch.from_numpy(untouched).float()[self._elements]
        self._flux = torch.from_numpy(stiff @ untouched).float()
        self._energy = float(np.vdot(untouched, stiff @ untouched))
        low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
        self.points = torch.from_numpy((2 * mesh.nodes - low - high) / (high - low).max()).float()
        self.scale = float(np.sqrt(np.mean(untouched**2)))

    def potentials(self, sigma: Array) -> Tensor:
        """The secondary potentials (n, E) [V/A] of an image (H, W) [S/m], by the exact model."""
        _, fields = self._model.voltages_and_fields(sigma[None])
        return torch.from_numpy(fields[0, : len(self._untouched)] - self._untouched).float()

    def of(self, relative: Tensor, potentials: Tensor) -> tuple[Tensor, Tensor]:
        """Predicted differences (M,) [V/A] and residual () of an image and secondary potentials.

        The residual is r^T G^-1 r over the energy of Y_0, with G = K(background) + M: the squared
        norm of r as a functional of the test functions. It bounds the error of W in energy, on any
        mesh (Rojas et al., Comput. Methods Appl. Mech. Eng. 425, 2024).

        Args:
            relative: conductivity over background (H, W).
            potentials: W (n, E) [V/A].
        """
        sigma = self._background * relative.flatten()
        if self._shares is not None:
            sigma = self._shares(sigma[:, None])[:, 0]
        flux = self._matrices @ (self._corners + potentials[self._elements])
        lost = (self._background - sigma)[:, None, None] * self._corners
        change = lost.flatten(0, 1).T @ flux.flatten(0, 1)
        # Small differences of large voltages are taken in double precision.
        touched = self._voltages(self._resistance + change.double())
        differences = touched - self._voltages(self._resistance)
        through = (sigma[:, None, None] * flux).flatten(0, 1)
        total = torch.zeros_like(potentials).index_add(0, self._elements.flatten(), through)
        residual = (total - self._flux + self._contact(potentials)).double()
        solved = torch.from_numpy(self._gram.solve(residual.detach().numpy()))
        # The derivative of r^T G^-1 r is twice that of r^T s with s = G^-1 r held fast.
        energy = 2 * (residual * solved).sum() - (residual.detach() * solved).sum()
        return differences, energy / self._energy

    def _voltages(self, resistance: Tensor) -> Tensor:
        """Voltages (M,) as the board measures them, of electrode resistances (E, E)."""
        src, sink, a, b = torch.from_numpy(self._pattern.table.T.copy())
        signed = resistance[a, src] - resistance[b, src] - resistance[a, sink] + resistance[b, sink]
        return signed.abs() if self._pattern.magnitudes else signed


class Product:
    """The product of a sparse matrix (m, n) and tensors (n, k), which autograd goes through."""

    def __init__(self, matrix: sparse.csr_array) -> None:
        found = sparse.coo_array(matrix)
        self._rows, self._columns = (torch.from_numpy(i.astype(np.int64)) for i in found.coords)
        self._values = torch.from_numpy(found.data).float()[:, None]
        self._length = found.shape[0]

    def __call__(self, tensor: Tensor) -> Tensor:
        """(n, k) to (m, k)."""
        total = tensor.new_zeros(self._length, tensor.shape[1])
        return total.index_add(0, self._rows, self._values * tensor[self._columns])


def _assembled(mesh: Mesh, sigma: float) -> sparse.csr_array:
    """K(sigma) (n, n) of one conductivity [S/m] everywhere."""
    corners = mesh.elements.shape[1]
    rows, columns = np.repeat(mesh.elements, corners, axis=1), np.tile(mesh.elements, corners)
    values = sigma * stiffness(mesh)
    size = len(mesh.nodes)
    made = sparse.coo_array((values.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))
    return sparse.csr_array(made)
