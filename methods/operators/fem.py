"""The exact forward operator."""

from typing import Any, ClassVar, NoReturn

import torch
from torch import Tensor

from eitbench.methods.operator import Operator
from eitbench.methods.registry import register_operator
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.sensors.sensor import Sensor


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
        ctx.save_for_backward(sigma)
        return torch.from_numpy(voltages).to(sigma)

    @staticmethod
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor, None]:
        (sigma,) = ctx.saved_tensors
        gradient: Tensor = _Gradient.apply(sigma, cotangent, ctx.fields, ctx.model)  # type: ignore[no-untyped-call]
        return gradient, None


class _Gradient(torch.autograd.Function):
    """J(sigma)^T cotangent, in the graph so that a second derivative is refused, not forgotten."""

    @staticmethod
    def forward(
        ctx: Any, sigma: Tensor, cotangent: Tensor, fields: Array, model: ForwardModel
    ) -> Tensor:
        return torch.from_numpy(model.pullback(fields, _double(cotangent))).to(cotangent)

    @staticmethod
    def backward(ctx: Any, *cotangents: Tensor) -> NoReturn:
        raise InputError("The operator 'fem' can be differentiated once, not twice.")


def _double(tensor: Tensor) -> Array:
    return tensor.detach().to("cpu", torch.float64).numpy()
