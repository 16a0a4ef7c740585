"""A plugin whose operators misbehave in a run, each in its own way, and one method beside them."""

import os
import time
from typing import Any

import numpy as np
import torch
from torch import Tensor

from eitbench.methods import Method, Operator, Problem, register, register_operator
from eitbench.scenarios import Sensor

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


@register_operator("toy-shape")
class Shape(Toy):
    """Forgets a measurement."""

    def voltages(self, sigma: Any) -> Any:
        return super().voltages(sigma)[..., :-1]


@register_operator("toy-nan")
class Nan(Toy):
    """Has no voltages for the image whose mean is the environment's."""

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        found = super().tensor_voltages(sigma)
        bad = torch.isclose(
            sigma.mean((1, 2)), torch.tensor(float(os.environ["TOY_MEAN"])).double()
        )
        return torch.where(bad[:, None], torch.nan, found)


@register_operator("toy-raises")
class Raises(Toy):
    """Has no gradient for that image."""

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        if np.isclose(sigma.mean((-2, -1)), float(os.environ["TOY_MEAN"])).any():
            raise ArithmeticError("this image diverges")
        return super().vjp(sigma, cotangent)


@register_operator("toy-mutates")
class Mutates(Toy):
    """Works in place."""

    def voltages(self, sigma: Any) -> Any:
        found = super().voltages(sigma)
        sigma *= 2
        return found


@register_operator("toy-hangs")
class Hangs(Toy):
    """Never answers."""

    def voltages(self, sigma: Any) -> Any:
        time.sleep(1000)


@register("toy-method")
class AMethod(Method):
    """A file may hold both."""

    def fit(self, problem: Problem) -> None:
        self.shape = problem.mask.shape

    def reconstruct(self, voltages: Array) -> Array:
        return np.ones((len(voltages), *self.shape))
