"""Checks of the interface of an operator: shapes, kinds of arrays, precision, refusals."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from eitbench.benchmark.checked_operator import CheckedOperator, close
from eitbench.benchmark.checking import BrokenError, SkippedError, require
from eitbench.benchmark.listing import first_line
from eitbench.scenarios.errors import InputError

# Relative differences: of float64 rounded in another order; of float32 from float64, in the
# voltages' response to a touch and in the gradient.
SAME = 1e-9
SINGLE = 1e-3


def described(subject: CheckedOperator) -> None:
    """A listing and a paper can name it."""
    cls = type(subject.operator)
    require(bool((cls.__doc__ or "").strip()), "its class has no docstring: say what it is.")
    require(bool(first_line(cls).strip()), "its docstring begins with an empty line.")
    require(bool(cls.source.strip()), "it names no publication: set `source`.")


def shapes(subject: CheckedOperator) -> None:
    """Any leading axes, and no images at all."""
    for leading in ((), (3,), (1, 3), (0,), (2, 0)):
        count = int(np.prod(leading))
        sigma = subject.sigma[:count] if count else subject.sigma[:0]
        images = sigma[0] if leading == () else sigma.reshape(*leading, *sigma.shape[1:])
        subject.asked_voltages(images)
        weights = np.ones((*leading, subject.sensor.n_measurements))
        subject.asked_gradient(images, weights)


def batch_equals_single(subject: CheckedOperator) -> str:
    """An image's answer does not depend on what is asked beside it."""
    alone = [subject.asked_voltages(image) for image in subject.sigma]
    said = close(subject.voltages, alone, SAME, "voltages alone and in a batch")
    pairs = zip(subject.sigma, subject.cotangent, strict=True)
    close(
        subject.gradient,
        [subject.asked_gradient(image, weights) for image, weights in pairs],
        SAME,
        "gradients alone and in a batch",
    )
    return said


def deterministic(subject: CheckedOperator) -> None:
    """The same answer twice, and from another operator of the same sensor."""
    again = subject.asked_voltages(subject.sigma)
    close(again, subject.voltages, 1e-12, "voltages asked for twice")
    other = subject.asked_voltages(subject.sigma, subject.make(subject.sensor))
    close(other, subject.voltages, 1e-12, "voltages of two operators of one sensor")


def unchanged_input(subject: CheckedOperator) -> None:
    """What comes in is the caller's."""
    sigma, cotangent = subject.sigma.copy(), subject.cotangent.copy()
    subject.operator.voltages(sigma)
    subject.operator.vjp(sigma, cotangent)
    same = np.array_equal(sigma, subject.sigma) and np.array_equal(cotangent, subject.cotangent)
    require(same, "voltages or vjp changes its input in place: work on a copy.")


def torch_tensors(subject: CheckedOperator) -> str:
    """Tensors in, equal tensors out."""
    import torch

    sigma, cotangent = torch.tensor(subject.sigma), torch.tensor(subject.cotangent)
    return _kind(subject, "torch tensors", torch.Tensor, sigma, cotangent)


def jax_arrays(subject: CheckedOperator) -> str:
    """JAX arrays in, equal JAX arrays out."""
    with double_jax() as jax:
        sigma, cotangent = jax.numpy.array(subject.sigma), jax.numpy.array(subject.cotangent)
        return _kind(subject, "JAX arrays", jax.Array, sigma, cotangent)


def _kind(subject: CheckedOperator, name: str, kind: type, sigma: Any, cotangent: Any) -> str:
    voltages = subject.operator.voltages(sigma)
    gradient = subject.operator.vjp(sigma, cotangent)
    for what, found in (("voltages", voltages), ("vjp", gradient)):
        require(isinstance(found, kind), f"{what} of {name} is a {type(found).__name__}.")
    close(gradient, subject.gradient, SAME, f"gradients of {name} and of NumPy arrays")
    return close(voltages, subject.voltages, SAME, f"voltages of {name} and of NumPy arrays")


def jax_transforms(subject: CheckedOperator) -> str:
    """`jax.jit`, `jax.vmap` and `jax.grad` go through, together too."""
    with double_jax() as jax:
        operator = subject.operator
        sigma, cotangent = jax.numpy.array(subject.sigma), jax.numpy.array(subject.cotangent)

        def along(image: Any, weights: Any) -> Any:
            return (weights * operator.voltages(image)).sum()

        one = jax.grad(along)(sigma[0], cotangent[0])
        close(one, subject.gradient[0], SAME, "jax.grad and the vjp")
        for name, mapped in (
            ("jit", jax.jit(operator.voltages)),
            ("vmap", jax.vmap(operator.voltages)),
        ):
            close(mapped(sigma), subject.voltages, SAME, f"voltages with and without jax.{name}")
        every = jax.jit(jax.vmap(jax.grad(along)))(sigma, cotangent)
        return close(every, subject.gradient, SAME, "jit(vmap(grad)) and the vjp")


@contextmanager
def double_jax() -> Iterator[Any]:
    """JAX with float64.

    Raises:
        SkippedError: it is not installed.
    """
    if importlib.util.find_spec("jax") is None:
        raise SkippedError("JAX is not installed: pip install 'eitbench[jax]'.")
    import jax

    config: Any = jax.config
    before = config.jax_enable_x64
    config.update("jax_enable_x64", True)
    try:
        yield jax
    finally:
        config.update("jax_enable_x64", before)


def precision_kept(subject: CheckedOperator) -> None:
    """float32 stays float32 and float64 stays float64."""
    import torch

    for name in ("float32", "float64"):
        sigma, cotangent = subject.sigma.astype(name), subject.cotangent.astype(name)
        kinds: tuple[Callable[[Any], Any], ...] = (np.asarray, torch.tensor)
        for kind in kinds:
            given = kind(sigma), kind(cotangent)
            found = subject.operator.voltages(given[0]), subject.operator.vjp(*given)
            for what, array in zip(("voltages", "vjp"), found, strict=True):
                got = str(array.dtype).removeprefix("torch.")
                require(got == name, f"{what} of {name} come back as {got}.")


def single_precision(subject: CheckedOperator) -> str:
    """float32 costs no more than its rounding."""
    sigma, cotangent = (a.astype(np.float32) for a in (subject.sigma, subject.cotangent))
    untouched = np.full_like(sigma[0], subject.sensor.background)
    response = subject.operator.voltages(sigma) - subject.operator.voltages(untouched)
    expected = subject.voltages - subject.background
    said = close(response, expected, SINGLE, "responses to a touch in float32 and float64")
    gradient = subject.operator.vjp(sigma, cotangent)
    close(gradient, subject.gradient, SINGLE, "gradients in float32 and float64")
    return said


def refuses_pixels(subject: CheckedOperator) -> None:
    """A conductivity that is not finite and above 0 S/m has no voltages."""
    for value in (0.0, -1.0, np.nan, np.inf):
        sigma = subject.sigma.copy()
        sigma[1, 3, 5] = value
        _refused(subject, sigma, subject.cotangent, f"a pixel of {value:g} S/m")


def refuses_grids(subject: CheckedOperator) -> None:
    """Another image grid is another sensor."""
    sigma = subject.sigma
    for shape in (sigma[..., :-1].shape, sigma[:, 1:].shape, (sigma[0].size,)):
        leading = shape[:-2]
        weights = np.ones((*leading, subject.sensor.n_measurements))
        _refused(subject, np.ones(shape), weights, f"conductivity of shape {shape}")


def refuses_precisions(subject: CheckedOperator) -> None:
    """Numbers that would lose accuracy are not converted silently."""
    for name in ("float16", "int64"):
        sigma = np.ones_like(subject.sigma).astype(name)
        _refused(subject, sigma, subject.cotangent, f"conductivity in {name}")


def refuses_cotangents(subject: CheckedOperator) -> None:
    """A cotangent belongs to one voltage each."""
    n, m = subject.cotangent.shape
    for shape in ((n, m - 1), (n - 1, m), (m,)):
        try:
            subject.operator.vjp(subject.sigma, np.ones(shape))
        except InputError:
            continue
        raise BrokenError(f"vjp takes a cotangent of shape {shape} for {n} images.")


def _refused(subject: CheckedOperator, sigma: Any, cotangent: Any, what: str) -> None:
    """Require an `InputError` from both functions, for NumPy arrays and for torch tensors."""
    import torch

    operator = subject.operator
    kinds: tuple[Callable[[Any], Any], ...] = (np.asarray, torch.tensor)
    for kind in kinds:
        given = kind(sigma)
        for name, ask in (
            ("voltages", partial(operator.voltages, given)),
            ("vjp", partial(operator.vjp, given, kind(cotangent))),
        ):
            try:
                ask()
            except InputError:
                continue
            except Exception as error:
                found = type(error).__name__
                raise BrokenError(
                    f"{name} of {what} raises a {found}, not an InputError."
                ) from error
            raise BrokenError(f"{name} takes {what}: raise an InputError that says what is wrong.")
