"""The forward model against an independent solver (EIDORS 3.10 on Octave, linear triangles)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.physics.mesh import grid_mesh

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def reference(reference_file: Path) -> dict[str, Array]:
    with np.load(reference_file, allow_pickle=False) as data:
        return dict(data)


def relative(value: Array, truth: Array) -> float:
    return float(np.linalg.norm(value - truth) / np.linalg.norm(truth))


def split_grid_model() -> ForwardModel:
    """foam16 on the reference's own element: each pixel cut into two linear triangles."""
    foam = sensor("foam16")
    grid = grid_mesh(foam)
    a, b, c, d = grid.elements.T
    triangles = np.stack([[a, b, d], [b, c, d]]).transpose(2, 0, 1).reshape(-1, 3)
    pixels = np.repeat(np.eye(len(grid.elements), dtype=np.float32), 2, axis=0)
    shares = sparse.csr_array(pixels, dtype=float)
    return ForwardModel(foam, replace(grid, elements=triangles, pixel_shares=shares))


def test_pattern_is_the_references(reference: dict[str, Array]) -> None:
    np.testing.assert_array_equal(sensor("foam16").pattern.table, reference["pattern"])


def test_voltages_of_bilinear_pixels(reference: dict[str, Array]) -> None:
    model = forward_model(sensor("foam16"))
    assert relative(model.voltages(np.ones((80, 80))), reference["v_homogeneous"]) < 0.002
    assert relative(model.voltages(reference["sigma_disc"]), reference["v_disc"]) < 0.002


def test_jacobian_of_bilinear_pixels(reference: dict[str, Array]) -> None:
    jacobian = forward_model(sensor("foam16")).jacobian(np.ones((80, 80)))
    theirs = reference["jacobian_homogeneous"].reshape(jacobian.shape)
    inner = (slice(None), slice(3, -3), slice(3, -3))
    assert relative(jacobian[inner], theirs[inner]) < 0.01
    assert relative(jacobian, theirs) < 0.05


def test_same_element_reproduces_the_reference_to_rounding(reference: dict[str, Array]) -> None:
    model = split_grid_model()
    one = np.ones((80, 80))
    assert relative(model.voltages(one), reference["v_homogeneous"]) < 1e-10
    assert relative(model.voltages(reference["sigma_disc"]), reference["v_disc"]) < 1e-10
    jacobian = model.jacobian(one)
    theirs = reference["jacobian_homogeneous"].reshape(jacobian.shape)
    assert relative(jacobian, theirs) < 1e-9
