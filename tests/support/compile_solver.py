"""Compile what solves the finite elements, before all processes of a test run do so at once.

    python tests/support/compile_solver.py

Numba keeps the code on disk. `make test` calls this after an installation.
"""

from concurrent.futures import ProcessPoolExecutor

import numpy as np

from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.physics.forward import forward_model

BATCH = 9
"""Images, so that they are solved side by side."""


def solve(images: int) -> None:
    """Voltages, fields, the gradient and the Jacobian of so many images."""
    model = forward_model(sensor("foam16"))
    sigma = np.repeat(model.background[None], images, axis=0)
    voltages, fields = model.voltages_and_fields(sigma)
    model.pullback(fields, voltages)
    model.voltages(sigma)
    model.jacobian(sigma[0])


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as pool:
        list(pool.map(solve, (1, BATCH)))
