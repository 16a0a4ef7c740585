"""Checks of the interface of an operator: shapes, kinds of arrays, precision, refusals."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from eitbench.benchmark.checks.checking import BrokenError, SkippedError, require
from eitbench.benchmark.checks.operator_under_test import OperatorUnderTest, close
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.errors import InputError

# Relative differences: of float64 rounded in another order; of float32 from float64, in the
# voltages' response to a touch and in the gradient.
SAME = 1e-9
SINGLE = 1e-3


def described(tested: OperatorUnderTest) -> None:
    """A listing and a paper can name it."""
    cls = type(tested.operator)
    require(bool((cls.__doc__ or "").strip()), "its class has no docstring: say what it is.")
    require(bool(first_line(cls).strip()), "its docstring begins with an empty line.")
    require(bool(cls.source.strip()), "it names no publication: set `source`.")


def shapes(tested: OperatorUnderTest) -> None:
    """Any leading axes, and no images at all."""
    for leading in ((), (3,), (1, 3), (0,), (2, 0)):
        count = int(np.prod(leading))
        sigma = tested.sigma[:count] if count else tested.sigma[:0]
        images = sigma[0] if leading == () else sigma.reshape(*leading, *sigma.shape[1:])
        tested.asked_voltages(images)
        weights = np.ones((*leading, tested.sensor.n_measurements))
        tested.asked_gradient(images, weights)


def batch_equals_single(tested: OperatorUnderTest) -> str:
    """An image's answer does not depend on what is asked beside it."""
    alone = [tested.asked_voltages(image) for image in tested.sigma]
    said = close(tested.voltages, alone, SAME, "voltages alone and in a batch")
    pairs = zip(tested.sigma, tested.cotangent, strict=True)
    close(
        tested.gradient,
        [tested.asked_gradient(image, weights) for image, weights in pairs],
        SAME,
        "gradients alone and in a batch",
    )
    return said


def deterministic(tested: OperatorUnderTest) -> None:
    """The same answer twice, and from another operator of the same sensor."""
    again = tested.asked_voltages(tested.sigma)
    close(again, tested.voltages, 1e-12, "voltages asked for twice")
    other = tested.asked_voltages(tested.sigma, tested.make(tested.sensor))
    close(other, tested.voltages, 1e-12, "voltages of two operators of one sensor")


def unchanged_input(tested: OperatorUnderTest) -> None:
    """What comes in is the caller's."""
    sigma, cotangent = tested.sigma.copy(), tested.cotangent.copy()
    tested.operator.voltages(sigma)
    tested.operator.vjp(sigma, cotangent)
    same = np.array_equal(sigma, tested.sigma) and np.array_equal(cotangent, tested.cotangent)
    require(same, "voltages or vjp changes its input in place: work on a copy.")


def torch_tensors(tested: OperatorUnderTest) -> str:
    """Tensors in, equal tensors out."""
    import torch

    sigma, cotangent = torch.tensor(tested.sigma), torch.tensor(tested.cotangent)
    return _kind(tested, "torch tensors", torch.Tensor, sigma, cotangent)


def jax_arrays(tested: OperatorUnderTest) -> str:
    """JAX arrays in, equal JAX arrays out."""
    with double_jax() as jax:
        sigma, cotangent = jax.numpy.array(tested.sigma), jax.numpy.array(tested.cotangent)
        return _kind(tested, "JAX arrays", jax.Array, sigma, cotangent)


def _kind(tested: OperatorUnderTest, name: str, kind: type, sigma: Any, cotangent: Any) -> str:
    voltages = tested.operator.voltages(sigma)
    gradient = tested.operator.vjp(sigma, cotangent)
    for what, found in (("voltages", voltages), ("vjp", gradient)):
        require(isinstance(found, kind), f"{what} of {name} is a {type(found).__name__}.")
    close(gradient, tested.gradient, SAME, f"gradients of {name} and of NumPy arrays")
    return close(voltages, tested.voltages, SAME, f"voltages of {name} and of NumPy arrays")


def jax_transforms(tested: OperatorUnderTest) -> str:
    """`jax.jit`, `jax.vmap` and `jax.grad` go through, together too."""
    with double_jax() as jax:
        operator = tested.operator
        sigma, cotangent = jax.numpy.array(tested.sigma), jax.numpy.array(tested.cotangent)

        def along(image: Any, weights: Any) -> Any:
            return (weights * operator.voltages(image)).sum()

        one = jax.grad(along)(sigma[0], cotangent[0])
        close(one, tested.gradient[0], SAME, "jax.grad and the vjp")
        for name, mapped in (
            ("jit", jax.jit(operator.voltages)),
            ("vmap", jax.vmap(operator.voltages)),
        ):
            close(mapped(sigma), tested.voltages, SAME, f"voltages with and without jax.{name}")
        every = jax.jit(jax.vmap(jax.grad(along)))(sigma, cotangent)
        return close(every, tested.gradient, SAME, "jit(vmap(grad)) and the vjp")


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


def precision_kept(tested: OperatorUnderTest) -> None:
    """float32 stays float32 and float64 stays float64."""
    import torch

    for name in ("float32", "float64"):
        sigma, cotangent = tested.sigma.astype(name), tested.cotangent.astype(name)
        kinds: tuple[Callable[[Any], Any], ...] = (np.asarray, torch.tensor)
        for kind in kinds:
            given = kind(sigma), kind(cotangent)
            found = tested.operator.voltages(given[0]), tested.operator.vjp(*given)
            for what, array in zip(("voltages", "vjp"), found, strict=True):
                got = str(array.dtype).removeprefix("torch.")
                require(got == name, f"{what} of {name} come back as {got}.")


def single_precision(tested: OperatorUnderTest) -> str:
    """float32 costs no more than its rounding."""
    sigma, cotangent = (a.astype(np.float32) for a in (tested.sigma, tested.cotangent))
    untouched = np.full_like(sigma[0], tested.sensor.background)
    response = tested.operator.voltages(sigma) - tested.operator.voltages(untouched)
    expected = tested.voltages - tested.background
    said = close(response, expected, SINGLE, "responses to a touch in float32 and float64")
    gradient = tested.operator.vjp(sigma, cotangent)
    close(gradient, tested.gradient, SINGLE, "gradients in float32 and float64")
    return said


def refuses_pixels(tested: OperatorUnderTest) -> None:
    """A conductivity that is not finite and above 0 S/m has no voltages."""
    for value in (0.0, -1.0, np.nan, np.inf):
        sigma = tested.sigma.copy()
        sigma[1, 3, 5] = value
        _refused(tested, sigma, tested.cotangent, f"a pixel of {value:g} S/m")


def refuses_grids(tested: OperatorUnderTest) -> None:
    """Another image grid is another sensor."""
    sigma = tested.sigma
    for shape in (sigma[..., :-1].shape, sigma[:, 1:].shape, (sigma[0].size,)):
        leading = shape[:-2]
        weights = np.ones((*leading, tested.sensor.n_measurements))
        _refused(tested, np.ones(shape), weights, f"conductivity of shape {shape}")


def refuses_precisions(tested: OperatorUnderTest) -> None:
    """Numbers that would lose accuracy are not converted silently."""
    for name in ("float16", "int64"):
        sigma = np.ones_like(tested.sigma).astype(name)
        _refused(tested, sigma, tested.cotangent, f"conductivity in {name}")


def refuses_cotangents(tested: OperatorUnderTest) -> None:
    """A cotangent belongs to one voltage each."""
    n, m = tested.cotangent.shape
    for shape in ((n, m - 1), (n - 1, m), (m,)):
        try:
            tested.operator.vjp(tested.sigma, np.ones(shape))
        except InputError:
            continue
        raise BrokenError(f"vjp takes a cotangent of shape {shape} for {n} images.")


def _refused(tested: OperatorUnderTest, sigma: Any, cotangent: Any, what: str) -> None:
    """Require an `InputError` from both functions, for NumPy arrays and for torch tensors."""
    import torch

    operator = tested.operator
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
