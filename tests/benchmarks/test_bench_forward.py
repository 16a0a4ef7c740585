"""The forward solve plus Jacobian beside the plain way: one sparse LU with 16 right-hand sides.

Run with `make bench`. The rival does the same work on the same system: assemble, factorise with
SciPy's SuperLU, solve for the 16 drive pairs and contract fields to the Jacobian.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture
from scipy import sparse
from scipy.sparse.linalg import splu

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.elements import electrode_terms, stiffness
from eitbench.scenarios.physics.forward import ForwardModel

Array = NDArray[np.float64]


class SparseLU:
    """The textbook implementation on the same mesh, elements and electrodes."""

    def __init__(self) -> None:
        self.sensor = sensor("foam16")
        self.mesh = ForwardModel(self.sensor).mesh
        self.local = stiffness(self.mesh)
        terms = electrode_terms(self.mesh, self.sensor.electrodes, self.sensor.outline.perimeter)
        n, e = terms.coupling.shape
        self.rows = np.repeat(self.mesh.elements, 4, axis=1).ravel()
        self.columns = np.tile(self.mesh.elements, (1, 4)).ravel()
        coupling = sparse.csr_array(-terms.coupling)
        conductance = sparse.csr_array(np.diag(terms.conductance))
        self.fixed = sparse.vstack(
            [sparse.hstack([terms.mass, coupling]), sparse.hstack([coupling.T, conductance])]
        )
        self.size = n + e
        src, sink = self.sensor.pattern.table[:, 0], self.sensor.pattern.table[:, 1]
        drives, self.drive = np.unique(np.column_stack([src, sink]), axis=0, return_inverse=True)
        self.currents = np.zeros((self.size, len(drives)))
        self.currents[n + drives[:, 0], np.arange(len(drives))] = 1
        self.currents[n + drives[:, 1], np.arange(len(drives))] = -1
        pairs = {tuple(d): k for k, d in enumerate(drives.tolist())}
        self.sense = [pairs[(a, b)] for a, b in self.sensor.pattern.table[:, 2:].tolist()]

    def voltages_and_jacobian(self, sigma: Array) -> tuple[Array, Array]:
        values = (sigma.ravel()[:, None, None] * self.local).ravel()
        stiff = sparse.coo_array((values, (self.rows, self.columns)), shape=(self.size, self.size))
        # Electrode 0 is the ground.
        keep = np.delete(np.arange(self.size), len(self.mesh.nodes))
        factor = splu(sparse.csc_matrix((stiff + self.fixed).tocsr()[keep][:, keep]))
        fields = np.zeros((self.size, self.currents.shape[1]))
        fields[keep] = factor.solve(self.currents[keep])
        electrodes = fields[len(self.mesh.nodes) :]
        _, _, a, b = self.sensor.pattern.table.T
        voltages = electrodes[a, self.drive] - electrodes[b, self.drive]
        corners = fields[self.mesh.elements]
        flux = np.einsum("kij,kjd->kid", self.local, corners)
        jacobian = -np.einsum("kim,kim->mk", flux[..., self.drive], corners[..., self.sense])
        return voltages, jacobian.reshape(-1, 80, 80)


def test_rivals_agree() -> None:
    sigma = np.exp(0.3 * np.random.default_rng(0).standard_normal((80, 80)))
    v, jacobian = ForwardModel(sensor("foam16")).linearise(sigma)
    v_lu, jacobian_lu = SparseLU().voltages_and_jacobian(sigma)
    np.testing.assert_allclose(v, v_lu, rtol=1e-8, atol=1e-10)
    assert np.linalg.norm(jacobian - jacobian_lu) < 1e-8 * np.linalg.norm(jacobian)


@pytest.mark.benchmark(group="foam16 80 x 80: voltages and Jacobian")
def test_eitbench(benchmark: BenchmarkFixture) -> None:
    model = ForwardModel(sensor("foam16"))
    benchmark(model.linearise, np.ones((80, 80)))


@pytest.mark.benchmark(group="foam16 80 x 80: voltages and Jacobian")
def test_sparse_lu(benchmark: BenchmarkFixture) -> None:
    benchmark(SparseLU().voltages_and_jacobian, np.ones((80, 80)))
