"""A plugin whose methods are a danger to the run that they are part of."""

import ctypes
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.methods import Method, Problem, register

Array = np.ndarray[Any, np.dtype[np.float64]]


class Untouched(Method):
    """Sees nothing, after it has done what its name says."""

    def fit(self, problem: Problem) -> None:
        self.image = np.full(problem.mask.shape, problem.background)

    def reconstruct(self, voltages: Array) -> Array:
        self.harm()
        return np.repeat(self.image[None], len(voltages), axis=0)

    def harm(self) -> None:
        """Do harm."""


@register("segfaults")
class Segfaults(Untouched):
    """Reads from nowhere."""

    def harm(self) -> None:
        ctypes.string_at(0)


@register("is-killed")
class IsKilled(Untouched):
    """Is killed, as the system does when memory runs out."""

    def harm(self) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


@register("takes-memory")
class TakesMemory(Untouched):
    """Takes all the memory there is, in its own process and in a child's."""

    def harm(self) -> None:
        if os.fork():
            os.wait()
        taken = np.ones(2**26)  # 512 MiB each
        time.sleep(600 + taken[0])


@register("forks")
class Forks(Untouched):
    """Comes back twice."""

    def harm(self) -> None:
        os.fork()


@register("leaves-a-daemon")
class LeavesADaemon(Untouched):
    """Leaves a process behind, in a session of its own."""

    def harm(self) -> None:
        if os.fork() == 0:
            os.setsid()
            Path(os.environ["HOSTILE_PID"]).write_text(str(os.getpid()))
            time.sleep(600)
            os._exit(0)


@register("prints-a-lot")
class PrintsALot(Untouched):
    """Prints more than a disk should hold, once."""

    left = 32

    def harm(self) -> None:
        while self.left:
            sys.stdout.write(4 * 2**20 * "x")
            self.left -= 1


@register("behaves")
class Behaves(Untouched):
    """Does no harm."""
