"""The exact forward operator."""

from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from eitbench.methods.operators.operator import Operator
from eitbench.methods.registry import register_operator
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.sensors import Sensor


@register_operator("fem")
class Fem(Operator):
    """The exact finite-element model with complete electrodes, and its adjoint derivative."""

    source: ClassVar[str] = "Somersalo, Cheney and Isaacson, SIAM J. Appl. Math. 52(4), 1992"
    exact: ClassVar[bool] = True

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self.model = forward_model(sensor)

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        """The exact voltages: (n, H, W) to (n, M), computed in float64 whatever comes in."""
        frames: Tensor = _Exact.apply(sigma, self.model)  # type: ignore[no-untyped-call]
        return frames


class _Exact(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, sigma: Tensor, model: ForwardModel) -> Tensor:
        raise NotImplementedError

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, None]:
        raise NotImplementedError
