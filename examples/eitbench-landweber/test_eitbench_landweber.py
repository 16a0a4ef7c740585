"""The method is the iteration that it says it is, and keeps eitbench's contract."""

from typing import Any

import numpy as np
import pytest
from eitbench_landweber import Landweber

from eitbench.benchmark.checks import check_target
from eitbench.methods import Problem
from eitbench.scenarios import forward_model, sensor


def _no_data(split: str, limit: int | None) -> Any:
    raise AssertionError(f"it learns nothing, and asked for the {split} split")


@pytest.mark.parametrize("iterations", [1, 3, 40])
def test_the_filter_is_the_iteration(iterations: int) -> None:
    """Step by step, with the gradient."""
    foam = sensor("foam16")
    model = forward_model(foam)
    sigma = np.ones((80, 80))
    sigma[20:40, 45:60] = 0.95
    problem = Problem(foam, model.voltages(model.background), _no_data)
    method = Landweber(iterations)
    method.fit(problem)
    frame = model.voltages(sigma)[None]

    jacobian = problem.jacobian.reshape(208, -1)
    step = 1 / np.linalg.norm(jacobian, 2) ** 2
    x = np.zeros(6400)
    for _ in range(iterations):
        x -= step * jacobian.T @ (jacobian @ x - problem.difference(frame)[0])
    expected = np.clip(1 + x, 0.05, 1.0).reshape(80, 80)
    np.testing.assert_allclose(method.reconstruct(frame)[0], expected, atol=1e-9)


def test_contract() -> None:
    """All of eitbench's checks pass."""
    (report,) = check_target("landweber")
    assert report.passed, "; ".join(f"{r.name}: {r.message}" for r in report.failed)
