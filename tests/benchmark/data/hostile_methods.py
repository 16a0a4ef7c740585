"""A plugin whose methods are a danger to the run that they are part of."""

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import psutil

from eitbench.methods import Method, Problem, register

Array = np.ndarray[Any, np.dtype[np.float64]]


def untouched(name: str, harm: Callable[[], object]) -> None:
    """Register a method that sees nothing, after it has done harm."""

    class Untouched(Method):
        def fit(self, problem: Problem) -> None:
            self.image = np.full(problem.mask.shape, problem.background)

        def reconstruct(self, voltages: Array) -> Array:
            harm()
            return np.repeat(self.image[None], len(voltages), axis=0)

    register(name)(Untouched)


def takes_memory() -> None:
    """Take all the memory there is, in its own process and in a child's."""
    os.fork()
    taken = np.ones(2**26)  # 512 MiB each
    time.sleep(600 + taken[0])


def leaves_a_daemon() -> None:
    """Leave a process behind, in a session of its own."""
    if os.fork() == 0:
        os.setsid()
        print(os.getpid(), flush=True)
        time.sleep(600)
        os._exit(0)


def kills_its_guard() -> None:
    """End the process that would tell how this one ended, where the kernel lets it."""
    with suppress(PermissionError):
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(600)
    os.kill(os.getpid(), signal.SIGKILL)


def kills_the_server() -> None:
    """End the process that forks the guards of workers."""
    for process in psutil.Process(int(os.environ["HOSTILE_RUN"])).children():
        with suppress(psutil.Error):  # it was killed before
            if "multiprocessing.forkserver" in " ".join(process.cmdline()):
                process.kill()


written: list[int] = []


def prints_a_lot() -> None:
    """Print more than a disk should hold, once."""
    while len(written) < 32:
        written.append(sys.stdout.write(4 * 2**20 * "x"))


untouched("segfaults", lambda: ctypes.string_at(0))
untouched("dies-of-a-signal", lambda: os.kill(os.getpid(), signal.SIGRTMIN + 6))  # without a name
untouched("is-killed", lambda: os.kill(os.getpid(), signal.SIGKILL))  # as without memory
untouched("kills-its-guard", kills_its_guard)
untouched("kills-the-server", kills_the_server)
untouched("takes-memory", takes_memory)
untouched("forks", os.fork)  # comes back twice
untouched("leaves-a-daemon", leaves_a_daemon)
untouched("prints-a-lot", prints_a_lot)
untouched("behaves", list)
