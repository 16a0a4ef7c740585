"""Times that can be compared: the calibration solve beside every cell, load, clock rate and core.

The work of the solve resembles what methods do: a sparse factorisation of a 5-point Laplacian on an
80 x 80 grid with 16 right-hand sides, then dense products the size of a Jacobian. A time over that
of the solve, taken just before and after on the same core, is compared between machines.
"""

import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
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

CALM_LOAD = 0.5
"""Cores that other programs may keep busy on a calm machine: they share its cache and memory."""
PATIENCE_S = 30.0
"""Time for which a board waits for a calm machine with each cell [s]."""

LOOK_S = 0.05
"""How long cores are watched for the idlest one [s]."""
_CORES = Path("/proc/stat")


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
    busy = dict(zip(_listed_cores(), psutil.cpu_percent(LOOK_S, percpu=True), strict=False))
    # Of equal ones the last: the first core serves most interrupts.
    return min(os.sched_getaffinity(0), key=lambda core: (busy.get(core, 0.0), -core))


def _listed_cores() -> list[int]:
    """The numbers of the cores whose loads the system lists: there are gaps where some are off."""
    return [int(core) for core in re.findall(r"^cpu(\d+)", _CORES.read_text(), re.MULTILINE)]


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


class Conditions:
    """The conditions under which a cell is timed: the calibration solve beside it, and load.

    Other programs slow a machine down for seconds at a time. Who times for a board says what a
    solve takes there when the machine is calm; what is timed beside slower ones, or while others
    are at work, does not count, for as long as `PATIENCE_S`. Nothing is chosen by what the timed
    method takes.

    Attributes:
        pinned: true if the cell has a core to itself.
    """

    def __init__(self, core: int | None, calm_ms: float | None = None) -> None:
        """Begin; `calm_ms` is the most that a solve takes on a calm machine, if it is waited for.

        Args:
            core: the core that the cell has to itself; None where it shares the machine.
        """
        self._core, self._calm_ms, self.pinned = core, calm_ms, core is not None
        self._last = self._solves()
        self._beside: list[list[float]] = []
        self._loads: list[float] = []
        self._load, self._end = _Load(), time.monotonic() + PATIENCE_S

    def _solves(self) -> list[float]:
        with on_core(self._core):
            return calibration_solves()

    @property
    def over(self) -> bool:
        """True if no calm machine is waited for any more."""
        return self._calm_ms is None or time.monotonic() > self._end

    def counts(self) -> bool:
        """True if what was timed since the last call counts.

        When time is up it counts if nothing did before.
        """
        if self._calm_ms is None:
            return True
        load, before, self._last = self._load.of_others(), self._last, self._solves()
        self._load = _Load()
        # Too short a time tells no load.
        calm = float(np.median(before + self._last)) <= self._calm_ms and not load > CALM_LOAD
        counts = calm or (self.over and not self._beside)
        if counts:
            self._loads += [] if np.isnan(load) else [load]
            # In a row the solves after one are those before the next.
            again = bool(self._beside) and self._beside[-1] is before
            self._beside += [self._last] if again else [before, self._last]
        return counts

    def columns(self) -> dict[str, Any]:
        """The columns of the cell, when it has been timed.

        They are `calibration_ms`, the median solve beside what counts; `calibration_spread`, the
        slowest of these over the fastest; `load`, the mean number of cores that other programs
        kept busy meanwhile; `cpu_mhz`, NaN where it is not known; and `timed`.
        """
        load = float(np.mean(self._loads)) if self._loads else self._load.of_others()
        mhz = _mhz()
        solves = np.concatenate(self._beside or [self._last, self._solves()])
        return {
            "timed": PINNED if self.pinned else SHARED,
            "load": load,
            "cpu_mhz": mhz,
            "calibration_ms": float(np.median(solves)),
            "calibration_spread": float(solves.max() / solves.min()),
        }


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
