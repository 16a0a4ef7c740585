"""Times that can be compared: the calibration solve beside every cell, load, clock rate and core.

The work of the solve resembles what methods do: a sparse factorisation of a 5-point Laplacian on an
80 x 80 grid with 16 right-hand sides, then dense products the size of a Jacobian. A time over that
of the solve, taken just before and after on the same core, is compared between machines.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

import numpy as np
import psutil
from scipy import sparse
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from eitbench.benchmark.rundir.kinds import PINNED, SHARED
from eitbench.scenarios.arrays import Array

SOLVES = 3
"""Solves before, and as many after, what is timed."""


LOOK_S = 0.05
"""How long cores are watched for the idlest one [s]."""


@cache
def _work() -> tuple[sparse.csc_array, Array, Array]:
    """Laplacian (6400, 6400), right-hand sides (6400, 16), and a matrix (208, 6400)."""
    side = 80
    line = sparse.diags_array([-1.0, 2.01, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    unit = sparse.eye_array(side)
    laplacian = sparse.csc_array(sparse.kron(line, unit) + sparse.kron(unit, line))
    right = np.cos(np.arange(side * side * 16, dtype=np.float64)).reshape(-1, 16)
    return laplacian, right, np.sin(np.arange(208 * side * side, dtype=np.float64)).reshape(208, -1)


def calibration_solves() -> list[float]:
    """Return the times of the calibration solve on one thread, `SOLVES` of them [ms]."""
    laplacian, right, dense = _work()
    times = []
    with threadpool_limits(1):
        for _ in range(SOLVES):
            start = time.perf_counter()
            solution = splu(laplacian).solve(right)
            dense @ solution
            dense @ dense.T
            times.append((time.perf_counter() - start) * 1e3)
    return times


def core_to_pin() -> int | None:
    """Return the idlest core, which a run with one cell at a time is timed on.

    None where a thread cannot be kept on a core.
    """
    if not hasattr(os, "sched_getaffinity"):
        return None
    busy = psutil.cpu_percent(LOOK_S, percpu=True)
    # Of equal ones the last: the first core serves most interrupts.
    return min(os.sched_getaffinity(0), key=lambda core: (busy[core], -core))


@contextmanager
def on_core(core: int | None) -> Iterator[None]:
    """Keep this thread on a core; None: leave it to the system."""
    if core is None:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def calibrated(core: int | None) -> Iterator[dict[str, Any]]:
    """Fill the columns of a cell that tell under which conditions it is timed in the block.

    They are `calibration_ms`, the median solve before and after; `calibration_spread`, the slowest
    of these solves over the fastest; `load`, the mean number of cores that other programs kept
    busy; `cpu_mhz`, NaN where it is not known; and `timed`.
    """
    found: dict[str, Any] = {"timed": SHARED if core is None else PINNED}
    with on_core(core):
        before = calibration_solves()
    load = _Load()
    yield found
    found["load"] = load.of_others()
    found["cpu_mhz"] = _mhz()
    with on_core(core):
        solves = before + calibration_solves()
    found["calibration_ms"] = float(np.median(solves))
    found["calibration_spread"] = max(solves) / min(solves)


class _Load:
    """Measures what programs other than this one do, from when it is made."""

    def __init__(self) -> None:
        self._start = self._state()

    def of_others(self) -> float:
        """Mean number of cores that others kept busy; NaN if too little time has passed."""
        (seconds, busy, own), (then, busy_then, own_then) = self._state(), self._start
        # The system counts in hundredths of a second.
        if seconds - then < 0.1:
            return float("nan")
        return max((busy - busy_then) - (own - own_then), 0.0) / (seconds - then)

    @staticmethod
    def _state() -> tuple[float, float, float]:
        """Time, processor time of all programs, and of this one and what it started [s]."""
        times, own, this = psutil.cpu_times(), 0.0, psutil.Process()
        for process in (this, *this.children(recursive=True)):
            with suppress(psutil.Error):
                spent = process.cpu_times()
                own += spent.user + spent.system
        # Where the system knows no such time there is no such attribute.
        busy = sum(getattr(times, kind, 0.0) for kind in ("user", "nice", "system", "irq", "steal"))
        return time.monotonic(), busy, own


def _mhz() -> float:
    """The processor's clock rate now [MHz]; NaN where it is not known."""
    with suppress(OSError, NotImplementedError, AttributeError):
        if found := psutil.cpu_freq():
            return float(found.current)
    return float("nan")
