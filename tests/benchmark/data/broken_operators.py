"""A plugin whose operators break one promise each, and one that keeps them all."""

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from eitbench.methods import Operator, register_operator
from eitbench.scenarios import InputError, Sensor, forward_model


class Linear(Operator):
    """The linear operator, for others to spoil."""

    source = "a textbook"

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        model = forward_model(sensor)
        reference, jacobian = model.linearise(model.background)
        self.reference = torch.from_numpy(reference)
        self.matrix = torch.from_numpy(jacobian.reshape(len(jacobian), -1))

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        contrast = (sigma - self.sensor.background).flatten(1)
        return self.reference.to(sigma) + contrast @ self.matrix.to(sigma).T


def spoilt(
    name: str,
    before: Callable[[Tensor], Tensor] = torch.clone,
    after: Callable[[Tensor], Tensor] = torch.clone,
) -> None:
    """Register an operator that does something to conductivities (n, H, W) or to voltages."""

    class Spoilt(Linear):
        """Spoilt in its own way."""

        def tensor_voltages(self, sigma: Tensor) -> Tensor:
            return after(super().tensor_voltages(before(sigma)))

    register_operator(name)(Spoilt)


def sloping(change: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """Have another derivative than one's own."""

    def apply(voltages: Tensor) -> Tensor:
        if voltages.requires_grad:
            voltages.register_hook(change)  # type: ignore[no-untyped-call]
        return voltages

    return apply


def coarse(sigma: Tensor) -> Tensor:
    """Compute in less than single precision where it may."""
    return sigma.bfloat16().to(sigma) if sigma.dtype == torch.float32 else sigma


def bent(cotangent: Tensor) -> Tensor:
    """Be no linear function."""
    return torch.mul(cotangent, 1 + 1e-6 * (cotangent**2).sum(1, keepdim=True).sqrt())


spoilt("operator-kept")
spoilt("operator-batch", after=lambda v: v * (1 + 1e-6 * (len(v) - 1)))  # sees the whole batch
spoilt("operator-single", before=coarse)
spoilt("operator-scaled", after=lambda v: 2 * v)  # of a sensor with half the conductivity
spoilt("operator-slope", after=sloping(lambda cotangent: 1.001 * cotangent))
spoilt("operator-bent", after=sloping(bent))


@register_operator("operator-nameless")
class Nameless(Linear):
    source = ""


@register_operator("operator-flat")
class Flat(Linear):
    """Forgets leading axes."""

    def voltages(self, sigma: Any) -> Any:
        found = super().voltages(sigma)
        return found.reshape(-1, found.shape[-1]) if len(sigma.shape) == 4 else found


@register_operator("operator-random")
class Random(Linear):
    """Starts from what the system calls random."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self.reference = self.reference * (1 + int.from_bytes(os.urandom(2)) / 2**30)


@register_operator("operator-in-place")
class InPlace(Linear):
    """Clears what it was given."""

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        found = super().vjp(sigma, cotangent)
        if isinstance(cotangent, np.ndarray) and cotangent.flags.writeable:
            cotangent *= 0
        return found


@register_operator("operator-numpy")
class OnlyNumpy(Linear):
    """Returns NumPy arrays whatever comes in."""

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        return np.asarray(super().vjp(sigma, cotangent))


@register_operator("operator-double")
class Double(Linear):
    """Returns float64 whatever comes in."""

    def voltages(self, sigma: Any) -> Any:
        values = super().voltages(sigma)
        if isinstance(values, Tensor):
            return values.double()
        return values.astype(np.float64) if isinstance(values, np.ndarray) else values


@register_operator("operator-detached")
class Detached(Linear):
    """Hides half of its derivative from autograd, but not from its own."""

    hidden = True

    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        seen = super().tensor_voltages(sigma)
        return (seen + seen.detach()) / 2 if self.hidden else seen

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        self.hidden = False
        try:
            return super().vjp(sigma, cotangent)
        finally:
            self.hidden = True


@register_operator("operator-one-way")
class OneWay(Linear):
    """Answers otherwise when drive and measuring pair are exchanged."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self.matrix = self.matrix * torch.linspace(0.5, 1.5, len(self.matrix))[:, None].double()


@register_operator("operator-boastful")
class Boastful(Linear):
    """Claims to be exact."""

    exact = True


@register_operator("operator-lenient")
class Lenient(Linear):
    """Takes anything for a conductivity."""

    def _checked_images(self, sigma: Tensor) -> Tensor:
        images = sigma.reshape(-1, *self.sensor.image_shape)
        return torch.nan_to_num(images, posinf=1.0).clamp_min(1e-3)


@register_operator("operator-cropping")
class Cropping(Linear):
    """Cuts or pads images to its own grid."""

    def _fitted(self, sigma: Any) -> Any:
        height, width = self.sensor.image_shape
        if isinstance(sigma, np.ndarray):
            return self._fitted(torch.from_numpy(sigma.copy())).numpy()
        if not isinstance(sigma, torch.Tensor):  # JAX
            return sigma
        while sigma.ndim < 2:
            sigma = sigma[None]
        fitted = torch.ones(*sigma.shape[:-2], height, width).to(sigma)
        rows, columns = min(height, sigma.shape[-2]), min(width, sigma.shape[-1])
        fitted[..., :rows, :columns] = sigma[..., :rows, :columns]
        return fitted

    def voltages(self, sigma: Any) -> Any:
        return super().voltages(self._fitted(sigma))

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        return super().vjp(self._fitted(sigma), cotangent)


@register_operator("operator-casting")
class Casting(Linear):
    """Converts whatever numbers it is given."""

    def _as_tensor(self, values: Any) -> tuple[Tensor, Callable[[Tensor], Any]]:
        if isinstance(values, np.ndarray) and values.dtype not in (np.float32, np.float64):
            values = values.astype(np.float64)
        if isinstance(values, torch.Tensor) and values.dtype not in (torch.float32, torch.float64):
            values = values.double()
        return super()._as_tensor(values)


@register_operator("operator-broadcasting")
class Broadcasting(Linear):
    """Stretches a cotangent that does not fit."""

    def vjp(self, sigma: Any, cotangent: Any) -> Any:
        shape = (*sigma.shape[:-2], self.sensor.n_measurements)
        if isinstance(cotangent, np.ndarray) and cotangent.shape != shape:
            cotangent = np.resize(cotangent, shape)
        return super().vjp(sigma, cotangent)


@register_operator("operator-large-only")
class LargeOnly(Linear):
    """Exists for the image grid it was trained for."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        if sensor.image_shape != (80, 80):
            raise InputError("There are no weights for this sensor.")
