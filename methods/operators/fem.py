"""The exact forward operator."""

from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from eitbench.methods.operators.operator import Operator
from eitbench.methods.registry import register_operator
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.sensors import Sensor


@register_operator("fem")
class Fem(Operator):
    """The exact finite-element model with complete electrodes, and its adjoint derivative.

    It computes in float64 whatever comes in, so that float32 costs no more than rounding what goes
    in and out: five to six digits of the voltages' response to a touch, measured in its tests.
    """

    source: ClassVar[str] = "Somersalo, Cheney and Isaacson, SIAM J. Appl. Math. 52(4), 1992"
    exact: ClassVar[bool] = True

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self.model = forward_model(sensor)

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        """The exact voltages: (n, H, W) to (n, M); differentiable once."""
        if not (torch.is_grad_enabled() and sigma.requires_grad):
            return torch.from_numpy(self.model.voltages(_double(sigma))).to(sigma)
        frames: Tensor = _Voltages.apply(sigma, self.model)  # type: ignore[no-untyped-call]
        return frames


class _Voltages(torch.autograd.Function):
    """`ForwardModel` under autograd: the derivation stands in `scenarios.physics.forward`."""

    @staticmethod
    def forward(ctx: Any, sigma: Tensor, model: ForwardModel) -> Tensor:
        voltages, ctx.fields = model.voltages_and_fields(_double(sigma))
        ctx.model = model
        return torch.from_numpy(voltages).to(sigma)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, None]:
        gradient = ctx.model.pullback(ctx.fields, _double(cotangent))
        return torch.from_numpy(gradient).to(cotangent), None


def _double(tensor: Tensor) -> NDArray[np.float64]:
    return tensor.detach().to("cpu", torch.float64).numpy()
