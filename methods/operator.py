"""The interface every forward operator keeps: one function of torch tensors, used from anywhere."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, cast

import numpy as np

from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from collections.abc import Callable

    from torch import Tensor

    from eitbench.scenarios.sensors.sensor import Sensor

Kind = TypeVar("Kind")  # numpy.ndarray, torch.Tensor or jax.Array

PRECISIONS = ("float32", "float64")


class Operator(ABC):
    """A forward operator F of one sensor; the first line of a subclass's docstring describes it.

    `voltages` and `vjp` take NumPy arrays, torch tensors (on any device; autograd goes through) or
    JAX arrays (`jax.jit`, `jax.vmap` and `jax.grad` go through; the work is done by torch on the
    host) and give back the same kind, in the precision and on the device of what came in.

    Attributes:
        source: the publication it follows.
        exact: True if it solves the model's equations, so that their laws must hold to rounding.
        precision: "float64" or "float32", the one it is scored and timed in: a network was trained
            in float32, and is slower and no more accurate in float64.
        sensor: what is modelled.
        train_s: time its weights took to train [s]; 0 if there was nothing to train.
        trained_on: the device they were trained on; "" if there was nothing to train.
    """

    source: ClassVar[str] = ""
    exact: ClassVar[bool] = False
    precision: ClassVar[str] = "float64"
    train_s: float = 0.0
    trained_on: str = ""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """SHA-256 (hex) of the file of weights that it loads for `sensor`; "" if there is none."""
        return ""

    @abstractmethod
    def tensor_voltages(self, sigma: Tensor) -> Tensor:
        """Voltages (n, M) [V/A] of checked `sigma` (n, H, W) [S/m]; autograd differentiates it.

        Pixels outside the sensor hold the background.
        """

    def voltages(self, sigma: Kind) -> Kind:
        """Voltages (..., M) [V/A] of conductivities `sigma` (..., H, W) [S/m].

        Raises:
            InputError: a wrong image shape, a pixel inside the sensor that is not finite and
                positive, numbers that are neither float32 nor float64, or an operator that returns
                another shape than it must. Inside `jax.jit`, values are looked at when the compiled
                function runs: JAX then raises an error of its own that quotes this one.
        """
        if _is_jax(sigma):
            self._check_jax(sigma)
            return cast("Kind", self._jax_functions[0](sigma))
        tensor, back = self._as_tensor(sigma)
        self._check_form(tensor)
        images = self._checked_images(tensor)
        frames = self.tensor_voltages(images)
        expected = (len(images), self.sensor.n_measurements)
        if frames.shape != expected:
            raise InputError(
                f"{type(self).__name__}.tensor_voltages must return shape {expected} for "
                f"{len(images)} images, not {tuple(frames.shape)}."
            )
        return cast("Kind", back(frames.to(images).reshape(*tensor.shape[:-2], expected[1])))

    def vjp(self, sigma: Kind, cotangent: Kind) -> Kind:
        """J(sigma)^T `cotangent`, (..., H, W), for `cotangent` (..., M); 0 outside the sensor.

        It is the gradient of sum(cotangent * voltages(sigma)) with respect to sigma.

        Raises:
            InputError: as for `voltages`; a cotangent of another shape.
        """
        import torch

        given, found = _shape(sigma), _shape(cotangent)
        expected = (*given[:-2], self.sensor.n_measurements)
        if found != expected:
            raise InputError(
                f"The cotangent of conductivities {given} has shape {expected}, got {found}."
            )
        if str(getattr(cotangent, "dtype", "float64")).removeprefix("torch.") not in PRECISIONS:
            raise InputError("A cotangent is an array of float32 or float64.")
        if _is_jax(sigma):
            self._check_jax(sigma)
            return cast("Kind", self._jax_functions[1](sigma, cotangent))
        tensor, back = self._as_tensor(sigma)
        self._check_form(tensor)
        weights = self._as_tensor(cotangent)[0].to(tensor)
        with torch.enable_grad():
            leaf = tensor.detach().requires_grad_()
            (gradient,) = torch.autograd.grad(self.voltages(leaf), leaf, weights.detach())
        return cast("Kind", back(gradient))

    def _as_tensor(self, values: Any) -> tuple[Tensor, Callable[[Tensor], Any]]:
        """`values` as a tensor, and the way back to their kind."""
        import torch

        if isinstance(values, torch.Tensor):
            return values, lambda tensor: tensor
        array = np.ascontiguousarray(values)
        if array.dtype.name not in PRECISIONS:
            raise _wrong_precision(array.dtype.name)
        # torch warns of arrays that may not be written to, as those of JAX are.
        tensor = torch.from_numpy(array if array.flags.writeable else array.copy())
        return tensor, lambda tensor: tensor.detach().numpy()

    def _check_form(self, sigma: Any) -> None:
        """Refuse a wrong shape or precision of a torch tensor or a JAX array."""
        shape = self.sensor.image_shape
        if len(sigma.shape) < 2 or tuple(sigma.shape[-2:]) != shape:
            raise InputError(
                f"Conductivity for {self.sensor.name!r} needs shape (..., {shape[0]}, {shape[1]}), "
                f"got {tuple(sigma.shape)}."
            )
        precision = str(sigma.dtype).removeprefix("torch.")
        if precision not in PRECISIONS:
            raise _wrong_precision(precision)

    def _check_jax(self, sigma: Any) -> None:
        """Refuse what can be seen to be wrong: under `jax.jit`, the values cannot be seen yet."""
        import jax

        self._check_form(sigma)
        if not isinstance(sigma, jax.core.Tracer):
            self._checked_images(self._as_tensor(sigma)[0])

    def _checked_images(self, sigma: Tensor) -> Tensor:
        """`sigma` as (n, H, W), with the background outside the sensor."""
        import torch

        images = sigma.reshape(-1, *self.sensor.image_shape)
        if not self.sensor.mask.all():
            mask = torch.from_numpy(self.sensor.mask).to(images.device)
            images = torch.where(mask, images, self.sensor.background)
        if not bool(((images > 0) & torch.isfinite(images)).all()):
            raise InputError("Conductivity must be finite and above 0 S/m in every pixel.")
        return images

    @cached_property
    def _jax_functions(self) -> tuple[Callable[[Any], Any], Callable[[Any, Any], Any]]:
        """`voltages` (differentiable) and `vjp` of JAX arrays, by callbacks to the host."""
        import jax

        def on_host(function: Callable[..., Any]) -> Callable[..., Any]:
            return lambda *arrays: function(*map(np.asarray, arrays))

        @jax.custom_vjp
        def voltages(sigma: Any) -> Any:
            shape = (*sigma.shape[:-2], self.sensor.n_measurements)
            result = jax.ShapeDtypeStruct(shape, sigma.dtype)  # type: ignore[no-untyped-call]
            return jax.pure_callback(
                on_host(self.voltages), result, sigma, vmap_method="broadcast_all"
            )

        def vjp(sigma: Any, cotangent: Any) -> Any:
            result = jax.ShapeDtypeStruct(sigma.shape, sigma.dtype)  # type: ignore[no-untyped-call]
            return jax.pure_callback(
                on_host(self.vjp), result, sigma, cotangent, vmap_method="broadcast_all"
            )

        voltages.defvjp(
            lambda sigma: (voltages(sigma), sigma),
            lambda sigma, cotangent: (vjp(sigma, cotangent),),
        )
        return voltages, vjp


def _shape(values: Any) -> tuple[int, ...]:
    return tuple(np.shape(values))


def _is_jax(values: object) -> bool:
    """True if `values` are JAX's; does not import JAX."""
    return type(values).__module__.partition(".")[0] in ("jax", "jaxlib")


def _wrong_precision(name: str) -> InputError:
    return InputError(
        f"Conductivity in {name} would lose accuracy: give float64, or float32 for six digits."
    )
