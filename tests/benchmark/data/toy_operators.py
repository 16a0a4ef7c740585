"""A plugin whose operators misbehave in a run, each in its own way, and one method beside them."""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from eitbench.methods import Method, Operator, Problem, register, register_operator
from eitbench.scenarios import Sensor, load

Array = np.ndarray[Any, np.dtype[np.float64]]


class Toy(Operator):
    """Every voltage is the mean conductivity, which is enough to have an answer."""

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        return sigma.mean((1, 2))[:, None] * torch.ones(self.sensor.n_measurements).to(sigma)


@register_operator("toy-flat")
class Flat(Toy):
    """Its voltages do not depend on the conductivity, so that its gradient is zero."""

    train_s = 3600.0
    trained_on = "a big machine"

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        return super().tensor_voltages(sigma) * 0.0 + 1.0


@register_operator("toy-set-up")
class SetUp(Toy):
    """Cannot be made."""

    def __init__(self, sensor: Sensor) -> None:
        raise RuntimeError("no weights for this sensor")


@register_operator("toy-cheats")
class Cheats(Toy):
    """Asks for the images that it will be judged by."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        load("quick", "test", 1)


def is_bad(sigma: Any) -> Any:
    """True for images whose mean is the environment's."""
    return abs(sigma.mean((-2, -1)) - float(os.environ["TOY_MEAN"])) < 1e-8


def toy(name: str, voltages: Callable[[Any, Any], Any]) -> None:
    """Register an operator whose answer is made of images (n, H, W) and of what a toy says."""

    class Misbehaving(Toy):
        def voltages(self, sigma: Any) -> Any:
            return voltages(sigma, super().voltages(sigma))

    register_operator(name)(Misbehaving)


toy("toy-shape", lambda sigma, found: found[..., :-1])
toy("toy-nan", lambda sigma, found: found / (1.0 - 1.0 * is_bad(sigma))[..., None])
toy("toy-mutates", lambda sigma, found: found * np.multiply(sigma, 2, out=sigma).size)


@register_operator("toy-raises")
class Raises(Toy):
    """Has no gradient for an image."""

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        if is_bad(sigma).any():
            raise ArithmeticError("this image diverges")
        return super().vjp(sigma, cotangent)


@register("toy-method")
class AMethod(Method):
    """A file may hold both."""

    def fit(self, problem: Problem) -> None:
        self.shape = problem.mask.shape

    def reconstruct(self, voltages: Array) -> Array:
        return np.ones((len(voltages), *self.shape))
