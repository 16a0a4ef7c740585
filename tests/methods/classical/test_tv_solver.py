"""The ADMM solver against an independent primal-dual iteration on a small dense problem."""

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.methods.classical.tv_solver import TVSolver

Array = NDArray[np.float64]
H, W = 7, 9


def differences() -> Array:
    """Forward differences (2, H*W, H*W) as dense matrices, zero across the rim."""
    index = np.arange(H * W).reshape(H, W)
    matrices = np.zeros((2, H * W, H * W))
    for i in range(H):
        for j in range(W):
            if j + 1 < W:
                matrices[0, index[i, j], [index[i, j], index[i, j + 1]]] = -1, 1
            if i + 1 < H:
                matrices[1, index[i, j], [index[i, j], index[i + 1, j]]] = -1, 1
    return matrices


def objective(x: Array, rows: Array, data: Array, weight: float) -> float:
    gradient = differences() @ x
    variation = np.sqrt((gradient**2).sum(axis=0)).sum()
    return float(0.5 * np.sum((rows @ x - data) ** 2) + weight * variation)


def chambolle_pock(rows: Array, data: Array, weight: float, bounds: tuple[float, float]) -> Array:
    """Condat and Vu's primal-dual iteration: slow, and nothing in common with ADMM."""
    d = differences()
    step = 0.9 / (np.linalg.norm(rows, 2) ** 2 / 2 + 8)
    x, p = np.zeros(rows.shape[1]), np.zeros((2, rows.shape[1]))
    for _ in range(60000):
        gradient = rows.T @ (rows @ x - data) + np.einsum("cij,ci->j", d, p)
        following = np.clip(x - step * gradient, *bounds)
        p = p + d @ (2 * following - x)
        p /= np.maximum(1, np.sqrt((p**2).sum(axis=0)) / weight)
        x = following
    return x


@pytest.mark.slow
def test_minimiser_is_the_one_of_an_independent_solver() -> None:
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((12, H * W))
    rows /= np.linalg.norm(rows, 2)
    truth = np.zeros((H, W))
    truth[2:5, 3:6] = -0.8
    data = rows @ truth.ravel() + 0.01 * rng.standard_normal(12)
    weight, bounds = 3e-3, (-0.5, 0.0)
    solver = TVSolver(rows.reshape(-1, H, W), weight, bounds)
    found = solver.run(data[None], solver.start(1), 5000).image[0].ravel()
    expected = chambolle_pock(rows, data, weight, bounds)
    reached, least = (objective(x, rows, data, weight) for x in (found, expected))
    assert abs(reached - least) < 1e-6 * least
    np.testing.assert_allclose(found, expected, atol=5e-3)
    assert found.min() >= bounds[0]
    assert found.max() <= bounds[1]


def test_a_warm_start_goes_on_where_the_last_run_stood() -> None:
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((6, H, W)) / 10
    data = rng.standard_normal((2, 6))
    solver = TVSolver(rows, 1e-2, (-1.0, np.inf))
    at_once = solver.run(data, solver.start(2), 40)
    in_two = solver.run(data, solver.run(data, solver.start(2), 15), 25)
    np.testing.assert_allclose(in_two.image, at_once.image, atol=1e-12)
