"""The exact operator beside its rivals on the same 80 x 80 problem, in one run on one thread.

`make bench` runs it and prints the ratios (see `ratios.py`).
"""

from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from pytest_benchmark.fixture import BenchmarkFixture
from scipy import sparse
from scipy.sparse.linalg import splu

from eitbench.methods import operator
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.physics.elements import electrode_terms, stiffness
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import scenario_by_name

Array = NDArray[np.float64]

BATCH = 64
ORDERINGS = ["COLAMD", "MMD_AT_PLUS_A"]
FORWARD = "forward"
JACOBIAN = "forward and Jacobian"


class SparseLU:
    """The textbook implementation on the same mesh, elements and electrodes.

    Args:
        ordering: SuperLU's column ordering. COLAMD is SciPy's default; MMD_AT_PLUS_A, together with
            SuperLU's symmetric mode, is the fastest of them here.
    """

    def __init__(self, ordering: str = "COLAMD") -> None:
        self.sensor = sensor("foam16")
        self.mesh = forward_model(self.sensor).mesh
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
        self.options: dict[str, Any] = {"permc_spec": ordering}
        if ordering == "MMD_AT_PLUS_A":
            self.options |= {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}

    def fields(self, sigma: Array) -> Array:
        """Potentials (nodes + 16, 16) of the 16 drive pairs: assembly, one LU, 16 right sides."""
        values = (sigma.ravel()[:, None, None] * self.local).ravel()
        stiff = sparse.coo_array((values, (self.rows, self.columns)), shape=(self.size, self.size))
        # Electrode 0 is the ground.
        keep = np.delete(np.arange(self.size), len(self.mesh.nodes))
        factor = splu(
            sparse.csc_matrix((stiff + self.fixed).tocsr()[keep][:, keep]), **self.options
        )
        fields = np.zeros((self.size, self.currents.shape[1]))
        fields[keep] = factor.solve(self.currents[keep])
        return fields

    def voltages(self, sigma: Array) -> Array:
        """Voltages (208,) of one image (80, 80)."""
        electrodes = self.fields(sigma)[len(self.mesh.nodes) :]
        _, _, a, b = self.sensor.pattern.table.T
        return np.asarray(electrodes[a, self.drive] - electrodes[b, self.drive])

    def voltages_and_jacobian(self, sigma: Array) -> tuple[Array, Array]:
        """Voltages (208,) and Jacobian (208, 80, 80), fields contracted one drive at a time."""
        fields = self.fields(sigma)
        electrodes = fields[len(self.mesh.nodes) :]
        _, _, a, b = self.sensor.pattern.table.T
        voltages = electrodes[a, self.drive] - electrodes[b, self.drive]
        corners = fields[self.mesh.elements]
        flux = np.einsum("kij,kjd->kid", self.local, corners)
        jacobian = -np.einsum("kim,kim->mk", flux[..., self.drive], corners[..., self.sense])
        return voltages, jacobian.reshape(-1, 80, 80)


class PyEit:
    """pyEIT on the same nodes: every square cut into two triangles, and point electrodes.

    pyEIT has no complete electrode model and solves anew for every drive pair.
    """

    def __init__(self) -> None:
        fem = pytest.importorskip("pyeit.eit.fem", reason="pyEIT is installed by `make bench`")
        from pyeit.eit import protocol
        from pyeit.mesh import PyEITMesh

        model = forward_model(sensor("foam16"))
        nodes, squares = model.mesh.nodes, model.mesh.elements
        centres = model.sensor.outline.point(np.array([e.centre for e in model.sensor.electrodes]))
        nearest = [int(np.argmin(np.sum((nodes - centre) ** 2, axis=1))) for centre in centres]
        mesh = PyEITMesh(
            node=np.column_stack([nodes, np.zeros(len(nodes))]),
            element=np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]]),
            el_pos=np.array(nearest),
            ref_node=nearest[0],
            perm=1.0,
        )
        plan = protocol.create(16, dist_exc=3, step_meas=3, parser_meas="std")
        self.model = fem.EITForward(mesh, plan)

    def voltages(self, sigma: Array) -> Array:
        """Voltages (208,) of one image (80, 80); pyEIT counts them with the other sign."""
        return -np.asarray(self.model.solve_eit(np.tile(sigma.ravel(), 2)))


@pytest.fixture(scope="module")
def images() -> Array:
    """Phantoms of the suite `paper` (BATCH, 80, 80) [S/m]."""
    scenario = scenario_by_name("paper")
    assert isinstance(scenario, SimulatedScenario)
    foam = scenario.nominal_sensor
    return np.array([rasterise(phantom(scenario, "test", k), foam) for k in range(BATCH)])


@pytest.mark.parametrize("ordering", ORDERINGS)
def test_sparse_lu_agrees(ordering: str, images: Array) -> None:
    """Voltages below 1e-9 relative to the LU; the same for the Jacobian."""
    rival, model = SparseLU(ordering), forward_model(sensor("foam16"))
    ours = model.voltages(images[:8])
    theirs = np.array([rival.voltages(image) for image in images[:8]])
    assert np.linalg.norm(ours - theirs, axis=1).max() < 1e-9 * np.linalg.norm(theirs, axis=1).min()
    jacobian = model.jacobian(images[0])
    _, theirs = rival.voltages_and_jacobian(images[0])
    assert np.linalg.norm(jacobian - theirs) < 1e-9 * np.linalg.norm(theirs)


def test_pyeit_solves_the_same_problem(images: Array) -> None:
    """To the difference between point electrodes and 10 mm wide ones."""
    ours, theirs = forward_model(sensor("foam16")).voltages(images[0]), PyEit().voltages(images[0])
    assert np.corrcoef(ours, theirs)[0, 1] > 0.999


@pytest.mark.benchmark(group=FORWARD, min_rounds=10, warmup=True)
def test_fem_batch(benchmark: BenchmarkFixture, images: Array) -> None:
    benchmark.extra_info["samples"] = len(images)
    benchmark(operator("fem", sensor("foam16")).voltages, images)


@pytest.mark.benchmark(group=FORWARD, min_rounds=10, warmup=True)
def test_fem_batch_alike(benchmark: BenchmarkFixture, images: Array) -> None:
    """The background but for a sixteenth of the pixels, as phantoms that explain one frame are."""
    alike = np.full_like(images, sensor("foam16").background)
    alike[:, 20:40, 30:50] = images[:, ::4, ::4]
    benchmark.extra_info["samples"] = len(images)
    benchmark(operator("fem", sensor("foam16")).voltages, alike)


@pytest.mark.benchmark(group=FORWARD, min_rounds=10, warmup=True)
def test_fem_one_by_one(benchmark: BenchmarkFixture, images: Array) -> None:
    fem = operator("fem", sensor("foam16"))
    benchmark.extra_info["samples"] = len(images)
    benchmark(lambda: [fem.voltages(image) for image in images])


@pytest.mark.benchmark(group=FORWARD, min_rounds=50, warmup=True)
def test_fem_single(benchmark: BenchmarkFixture, images: Array) -> None:
    benchmark(operator("fem", sensor("foam16")).voltages, images[0])


def with_gradient(benchmark: BenchmarkFixture, images: Array) -> None:
    fem = operator("fem", sensor("foam16"))
    sigma = torch.from_numpy(images).requires_grad_()

    def forward_and_gradient() -> None:
        sigma.grad = None
        fem.voltages(sigma).square().sum().backward()  # type: ignore[no-untyped-call]

    benchmark.extra_info["samples"] = len(images)
    benchmark(forward_and_gradient)


@pytest.mark.benchmark(group=FORWARD, min_rounds=10, warmup=True)
def test_fem_batch_and_gradient(benchmark: BenchmarkFixture, images: Array) -> None:
    with_gradient(benchmark, images)


@pytest.mark.benchmark(group=FORWARD, min_rounds=50, warmup=True)
def test_fem_single_and_gradient(benchmark: BenchmarkFixture, images: Array) -> None:
    with_gradient(benchmark, images[:1])


@pytest.mark.benchmark(group=FORWARD, min_rounds=10)
@pytest.mark.parametrize("ordering", ORDERINGS)
def test_sparse_lu(benchmark: BenchmarkFixture, ordering: str, images: Array) -> None:
    benchmark(SparseLU(ordering).voltages, images[0])


@pytest.mark.benchmark(group=FORWARD, min_rounds=5)
def test_pyeit(benchmark: BenchmarkFixture, images: Array) -> None:
    benchmark(PyEit().voltages, images[0])


@pytest.mark.benchmark(group="matrix product", min_rounds=10)
def test_matrix_product(benchmark: BenchmarkFixture) -> None:
    """A product of 1000 x 1000 matrices in float64: the highest rate of the machine."""
    a = np.random.default_rng(0).standard_normal((1000, 1000))
    benchmark.extra_info["operations"] = 2 * 1000**3
    benchmark(np.dot, a, a)


@pytest.mark.benchmark(group=JACOBIAN)
def test_fem_jacobian(benchmark: BenchmarkFixture, images: Array) -> None:
    benchmark(forward_model(sensor("foam16")).linearise, images[0])


@pytest.mark.benchmark(group=JACOBIAN)
def test_sparse_lu_jacobian(benchmark: BenchmarkFixture, images: Array) -> None:
    benchmark(SparseLU().voltages_and_jacobian, images[0])
