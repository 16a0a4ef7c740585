"""A plugin whose methods misbehave, each in its own way."""

import os
import signal
import time
from typing import Any

import numpy as np

from eitbench.methods import Method, Problem, register

Array = np.ndarray[Any, np.dtype[np.float64]]


class Toy(Method):
    """Back-projection without any care: enough to have a result."""

    def fit(self, problem: Problem) -> None:
        self.problem = problem
        self.spread = problem.jacobian.reshape(len(problem.jacobian), -1)
        self.spread = self.spread / np.abs(self.spread).sum() * 100

    def reconstruct(self, voltages: Array) -> Array:
        contrast = self.problem.difference(voltages) @ self.spread
        return self.problem.background + contrast.reshape(-1, *self.problem.mask.shape)


@register("toy-good")
class Good(Toy):
    """Behaves."""


@register("toy-raises")
class Raises(Toy):
    """Raises always."""

    def reconstruct(self, voltages: Array) -> Array:
        raise RuntimeError("the sky is falling")


@register("toy-nan")
class Nan(Toy):
    """Returns NaN in the second frame of a batch."""

    def reconstruct(self, voltages: Array) -> Array:
        images = super().reconstruct(voltages)
        images[1:2, 3, 3] = np.nan
        return images


@register("toy-shape")
class Shape(Toy):
    """Returns flat images."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages).reshape(len(voltages), -1)


@register("toy-complex")
class Complex(Toy):
    """Returns complex numbers."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages) + 1j  # type: ignore[return-value]


@register("toy-ragged")
class Ragged(Toy):
    """Returns something that is no array."""

    def reconstruct(self, voltages: Array) -> Array:
        return [[1.0], [1.0, 2.0]]  # type: ignore[return-value]


@register("toy-prints")
class Prints(Toy):
    """Prints, from Python and from below it."""

    def reconstruct(self, voltages: Array) -> Array:
        print("hello from the plugin")
        os.write(1, b"hello from the system\n")
        return super().reconstruct(voltages)


@register("toy-hangs")
class Hangs(Toy):
    """Never answers."""

    def reconstruct(self, voltages: Array) -> Array:
        time.sleep(1000)
        return super().reconstruct(voltages)


@register("toy-fit-raises")
class FitRaises(Toy):
    """Cannot be set up."""

    def fit(self, problem: Problem) -> None:
        raise ValueError("no licence for this sensor")


@register("toy-mutates")
class Mutates(Toy):
    """Subtracts the reference in place."""

    def reconstruct(self, voltages: Array) -> Array:
        images = super().reconstruct(voltages)
        voltages -= self.problem.reference
        return images


@register("toy-killed")
class Killed(Toy):
    """Is killed, as the system does when memory runs out."""

    def reconstruct(self, voltages: Array) -> Array:
        if len(voltages) > 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().reconstruct(voltages)


@register("toy-dies-on-one")
class DiesOnOne(Toy):
    """Ends the process on a frame whose largest voltage passes a limit from the environment."""

    def reconstruct(self, voltages: Array) -> Array:
        if (voltages.max(axis=1) > float(os.environ["TOY_LIMIT"])).any():
            os._exit(5)
        return super().reconstruct(voltages)


@register("toy-dies-on-first")
class DiesOnFirst(Toy):
    """Ends the process on the frame with a largest voltage from the environment."""

    def reconstruct(self, voltages: Array) -> Array:
        if (voltages.max(axis=1) == float(os.environ["TOY_FIRST"])).any():
            os._exit(5)
        return super().reconstruct(voltages)


@register("toy-strange-error")
class StrangeError(Toy):
    """Raises a message that is long and no valid Unicode."""

    def reconstruct(self, voltages: Array) -> Array:
        raise ValueError("\ud800" + 10000 * "x")


@register("toy-memory")
class Memory(Toy):
    """Asks for too much in a batch."""

    def reconstruct(self, voltages: Array) -> Array:
        if len(voltages) > 1:
            raise MemoryError("batch too large")
        return super().reconstruct(voltages)


@register("toy-no-memory")
class NoMemory(Toy):
    """Asks for too much always."""

    def reconstruct(self, voltages: Array) -> Array:
        raise MemoryError("image too large")


@register("toy-exits")
class Exits(Toy):
    """Ends the process."""

    def reconstruct(self, voltages: Array) -> Array:
        os._exit(3)


@register("toy-one-bad")
class OneBad(Toy):
    """Raises on a frame whose largest voltage passes a limit from the environment."""

    def reconstruct(self, voltages: Array) -> Array:
        if (voltages.max(axis=1) > float(os.environ["TOY_LIMIT"])).any():
            raise ArithmeticError("this frame diverges")
        return super().reconstruct(voltages)


@register("toy-random")
class Random(Toy):
    """Draws from the global generator."""

    def reconstruct(self, voltages: Array) -> Array:
        return super().reconstruct(voltages) + 0.01 * np.random.rand()  # noqa: NPY002


@register("toy-slow")
class Slow(Random):
    """Takes its time."""

    def reconstruct(self, voltages: Array) -> Array:
        time.sleep(0.02 * len(voltages))
        return super().reconstruct(voltages)
