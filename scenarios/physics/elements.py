"""Element matrices: the weak form of div(sigma grad u) = 0 and of the complete electrode model.

The complete electrode model (Somersalo, Cheney and Isaacson 1992): find the potential u and the
electrode potentials U such that for all test functions w and W

    int sigma grad u . grad w  +  sum_l 1/z_l int_{e_l} (u - U_l)(w - W_l)  =  sum_l I_l W_l.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.physics.mesh import Mesh
from eitbench.scenarios.sensors.sensor import Electrode

# Two-point Gauss rule on [0, 1]: exact for the products of bilinear gradients on a rectangle.
GAUSS = (0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3))


@lru_cache(maxsize=8)
def stiffness(mesh: Mesh) -> Array:
    """int grad N_i . grad N_j over each element at sigma = 1 S/m: (k, c, c) [1], c corners."""
    corners = mesh.nodes[mesh.elements]
    if corners.shape[1] == 3:
        return _weighted_gradients(corners, np.array([[-1.0, 1, 0], [-1, 0, 1]]), 0.5)
    total = np.zeros((*corners.shape[:2], 4))
    for s in GAUSS:
        for t in GAUSS:
            slopes = np.array([[t - 1, 1 - t, t, -t], [s - 1, -s, s, 1 - s]])
            total += _weighted_gradients(corners, slopes, 0.25)
    return total


def _weighted_gradients(corners: Array, slopes: Array, weight: float) -> Array:
    """weight |det F| (F^-T slopes)^T (F^-T slopes), F the map from the reference element."""
    jacobian = np.einsum("rc,kcx->krx", slopes, corners)
    gradients = np.linalg.solve(jacobian, np.broadcast_to(slopes, (len(corners), *slopes.shape)))
    measure = weight * np.abs(np.linalg.det(jacobian))
    return np.asarray(np.einsum("k,kxi,kxj->kij", measure, gradients, gradients))


@lru_cache(maxsize=8)
def couplings(mesh: Mesh) -> tuple[NDArray[np.uint32], Array]:
    """Corners (k, 4) of the elements and K_ij (k, 6) of the pairs 01, 02, 03, 12, 13, 23 of them.

    Triangles have their last corner twice, the second time without any coupling.
    """
    missing = 4 - mesh.elements.shape[1]
    corners = np.pad(mesh.elements, ((0, 0), (0, missing)), mode="edge").astype(np.uint32)
    padded = np.pad(stiffness(mesh), ((0, 0), (0, missing), (0, missing)))
    i, j = np.triu_indices(4, 1)
    return corners, padded[:, i, j]


class ElectrodeTerms(NamedTuple):
    """The boundary terms of the complete electrode model, in S (2-D: S per metre of thickness).

    Attributes:
        mass: (n, n) sparse, sum_l 1/z_l int_{e_l} N_i N_j.
        coupling: (n, E), 1/z_l int_{e_l} N_i.
        conductance: (E,), 1/z_l int_{e_l} 1.
    """

    mass: sparse.csr_array
    coupling: Array
    conductance: Array


def electrode_terms(
    mesh: Mesh, electrodes: tuple[Electrode, ...], perimeter: float
) -> ElectrodeTerms:
    """Integrals over the electrodes; an electrode may begin or end inside an edge of the rim."""
    n = len(mesh.nodes)
    mass = sparse.csr_array((n, n))
    coupling = np.zeros((n, len(electrodes)), order="F")  # LAPACK's order
    begin, end = mesh.rim_arcs.T
    chord = np.hypot(*(mesh.nodes[mesh.rim_edges[:, 1]] - mesh.nodes[mesh.rim_edges[:, 0]]).T)
    for number, electrode in enumerate(electrodes):
        # Shift the electrode by whole turns so that it overlaps the edges' interval of arc lengths.
        for turn in (-perimeter, 0.0, perimeter):
            centre = electrode.centre % perimeter + turn
            low = np.clip((centre - electrode.width / 2 - begin) / (end - begin), 0, 1)
            high = np.clip((centre + electrode.width / 2 - begin) / (end - begin), 0, 1)
            touched = np.flatnonzero(high - low > 1e-12)
            if not touched.size:
                continue
            scale = chord[touched] / electrode.contact_impedance
            load, pair = _edge_integrals(low[touched], high[touched])
            nodes = mesh.rim_edges[touched]
            np.add.at(coupling[:, number], nodes, scale[:, None] * load)
            rows, columns = np.repeat(nodes, 2, axis=1), np.tile(nodes, (1, 2))
            values = (scale[:, None, None] * pair).reshape(-1, 4)
            mass = mass + sparse.coo_array(
                (values.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)
            )
    return ElectrodeTerms(sparse.csr_array(mass), coupling, coupling.sum(axis=0))


def _edge_integrals(low: Array, high: Array) -> tuple[Array, Array]:
    """int N (r, 2) and int N N^T (r, 2, 2) over [low, high] of a unit edge, N = (1 - t, t)."""
    one, t, tt = high - low, (high**2 - low**2) / 2, (high**3 - low**3) / 3
    load = np.stack([one - t, t], axis=-1)
    pair = np.stack([one - 2 * t + tt, t - tt, t - tt, tt], axis=-1)
    return load, pair.reshape(-1, 2, 2)
