"""A plugin whose methods misbehave, each in its own way."""

import os
import signal
import time
from collections.abc import Callable
from typing import Any, NoReturn

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


@register("toy-fit-raises")
class FitRaises(Toy):
    """Cannot be set up."""

    source = "A. Author, Fits that fail, 2024,\ndoi:10.1000/182"

    def fit(self, problem: Problem) -> None:
        raise ValueError("no licence for this sensor")


def toy(
    name: str, before: Callable[[Array], object] = len, after: Callable[[Array], Any] = np.asarray
) -> None:
    """Register a toy that does something to its frames before it reconstructs, or to its images."""

    class Misbehaving(Toy):
        def reconstruct(self, voltages: Array) -> Any:
            before(voltages)
            return after(super().reconstruct(voltages))

    register(name)(Misbehaving)


def fail(error: Exception) -> NoReturn:
    raise error


def prints(_: Array) -> None:
    """Print, from Python and from below it."""
    print("hello from the plugin")
    os.write(1, b"hello from the system\n")


def hangs(_: Array) -> None:
    """Say who does."""
    print(os.getpid(), flush=True)
    time.sleep(1000)


def is_killed_by_a_batch(voltages: Array) -> None:
    """As the system does when memory runs out."""
    if len(voltages) > 1:
        os.kill(os.getpid(), signal.SIGKILL)


def beyond_limit(voltages: Array) -> bool:
    """True for a frame whose largest voltage passes a limit from the environment."""
    return bool((voltages.max(axis=1) > float(os.environ["TOY_LIMIT"])).any())


def is_first(voltages: Array) -> bool:
    """True for the frame with a largest voltage from the environment."""
    return bool((voltages.max(axis=1) == float(os.environ["TOY_FIRST"])).any())


def with_hole(images: Array) -> Array:
    """Have a NaN in the second image of a batch."""
    images[1:2, 3, 3] = np.nan
    return images


def with_spike(images: Array) -> Array:
    """Have one pixel far beyond what any sensor has, in the second image of a batch."""
    images[1:2, 3, 3] = 1e30
    return images


def with_noise(images: Array) -> Array:
    """Draw from the global generator."""
    return np.asarray(images + 0.01 * np.random.rand())  # noqa: NPY002


toy("toy-good")
toy("toy-raises", lambda v: fail(RuntimeError("the sky is falling")))
toy("toy-nan", after=with_hole)
toy("toy-wild", after=with_spike)
toy("toy-masked", after=lambda images: np.ma.array(images, mask=True))
toy("toy-shape", after=lambda images: images.reshape(len(images), -1))
toy("toy-complex", after=lambda images: images + 1j)
toy("toy-ragged", after=lambda images: [[1.0], [1.0, 2.0]])
toy("toy-prints", prints)
toy("toy-hangs", hangs)
toy("toy-mutates", lambda v: np.subtract(v, 1.0, out=v))
toy("toy-killed", is_killed_by_a_batch)
toy("toy-dies-on-one", lambda v: beyond_limit(v) and os._exit(5))
toy("toy-dies-on-first", lambda v: is_first(v) and os._exit(5))
toy("toy-strange-error", lambda v: fail(ValueError("\ud800" + 10000 * "x")))
toy("toy-memory", lambda v: len(v) > 1 and fail(MemoryError("batch too large")))
toy("toy-no-memory", lambda v: fail(MemoryError("image too large")))
toy("toy-exits", lambda v: os._exit(3))
toy("toy-one-bad", lambda v: beyond_limit(v) and fail(ArithmeticError("this frame diverges")))
toy("toy-random", after=with_noise)
toy("toy-slow", lambda v: time.sleep(0.02 * len(v)), with_noise)
