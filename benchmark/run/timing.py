"""A calibration solve of the machine, which makes times comparable."""

import time
from functools import cache

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits


@cache
def calibration() -> float:
    """Return the milliseconds of a fixed solve on one thread (the fastest of five).

    Measured when it is first asked for.

    The work resembles what methods do: a sparse factorisation of a 5-point Laplacian on an
    80 x 80 grid with 16 right-hand sides, then a dense product the size of a Jacobian. Times of two
    machines may be divided by it to be compared.
    """
    side = 80
    line = sparse.diags_array([-1.0, 2.01, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    unit = sparse.eye_array(side)
    laplacian = sparse.csc_array(sparse.kron(line, unit) + sparse.kron(unit, line))
    right = np.cos(np.arange(side * side * 16, dtype=np.float64)).reshape(-1, 16)
    dense = np.sin(np.arange(208 * side * side, dtype=np.float64)).reshape(208, -1)
    fastest = np.inf
    with threadpool_limits(1):
        for _ in range(5):
            start = time.perf_counter()
            solution = splu(laplacian).solve(right)
            dense @ solution
            dense @ dense.T
            fastest = min(fastest, time.perf_counter() - start)
    return fastest * 1e3
