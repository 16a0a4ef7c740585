"""The checks of operators: every public function, in the order they run.

First the interface: shapes, kinds of arrays, precision. Then the mathematics: derivatives,
reciprocity, scaling. Last what is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from eitbench.benchmark.checks.harness import BrokenError, SkippedError, require
from eitbench.benchmark.checks.operator_under_test import OperatorUnderTest, close
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.extras import missing
from eitbench.scenarios.physics.forward import forward_model

# Relative differences: of float64 rounded in another order; of float32 from float64, in the
# voltages' response to a touch and in the gradient.
SAME = 1e-9
SINGLE = 1e-3
# Allowed relative difference to the model's voltages of the untouched sensor.
REFERENCE = 0.1
# Laws that an exact operator obeys to rounding, relative to the voltages.
LAW = 1e-9
# Others may break reciprocity by this part of the response to a touch.
BROKEN_RECIPROCITY = 0.1
# Gradients against differences; networks with kinks have no derivative there.
GRADIENT_EXACT, GRADIENT_OTHER = 1e-6, 1e-4
DIRECTIONS = 6


def described(tested: OperatorUnderTest) -> None:
    """Has a description and a source."""
    cls = type(tested.operator)
    require(bool((cls.__doc__ or "").strip()), "its class has no docstring: say what it is.")
    require(bool(first_line(cls).strip()), "its docstring begins with an empty line.")
    require(bool(cls.source.strip()), "it names no publication: set `source`.")


def shapes(tested: OperatorUnderTest) -> None:
    """Returns (..., M) for images (..., H, W).

    Also for no images at all.
    """
    for leading in ((), (3,), (1, 3), (0,), (2, 0)):
        count = int(np.prod(leading))
        sigma = tested.sigma[:count] if count else tested.sigma[:0]
        images = sigma[0] if leading == () else sigma.reshape(*leading, *sigma.shape[1:])
        tested.voltages_of(images)
        weights = np.ones((*leading, tested.sensor.n_measurements))
        tested.gradient_of(images, weights)


def batch_equals_single(tested: OperatorUnderTest) -> str:
    """A batch equals its single images."""
    alone = [tested.voltages_of(image) for image in tested.sigma]
    said = close(tested.voltages, alone, SAME, "voltages of an image alone and in a batch")
    pairs = zip(tested.sigma, tested.cotangent, strict=True)
    gradients = [tested.gradient_of(image, weights) for image, weights in pairs]
    close(tested.gradient, gradients, SAME, "gradients of an image alone and in a batch")
    return said


def deterministic(tested: OperatorUnderTest) -> None:
    """The same twice.

    And from another operator of the same sensor.
    """
    again = tested.voltages_of(tested.sigma)
    close(again, tested.voltages, 1e-12, "voltages asked for twice")
    other = tested.voltages_of(tested.sigma, tested.make(tested.sensor))
    close(other, tested.voltages, 1e-12, "voltages of two operators of one sensor")


def unchanged_input(tested: OperatorUnderTest) -> None:
    """Leaves its input unchanged."""
    sigma, cotangent = tested.sigma.copy(), tested.cotangent.copy()
    tested.operator.voltages(sigma)
    tested.operator.vjp(sigma, cotangent)
    same = np.array_equal(sigma, tested.sigma) and np.array_equal(cotangent, tested.cotangent)
    require(same, "voltages or vjp changes its input in place: work on a copy.")


def torch_tensors(tested: OperatorUnderTest) -> str:
    """Takes and returns torch tensors."""
    import torch

    sigma, cotangent = torch.tensor(tested.sigma), torch.tensor(tested.cotangent)
    return _require_kind(tested, "torch tensors", torch.Tensor, sigma, cotangent)


def jax_arrays(tested: OperatorUnderTest) -> str:
    """Takes and returns JAX arrays."""
    with _double_jax() as jax:
        sigma, cotangent = jax.numpy.array(tested.sigma), jax.numpy.array(tested.cotangent)
        return _require_kind(tested, "JAX arrays", jax.Array, sigma, cotangent)


def _require_kind(
    tested: OperatorUnderTest, name: str, kind: type, sigma: Any, cotangent: Any
) -> str:
    voltages = tested.operator.voltages(sigma)
    gradient = tested.operator.vjp(sigma, cotangent)
    for what, found in (("voltages", voltages), ("vjp", gradient)):
        require(isinstance(found, kind), f"{what} of {name} is a {type(found).__name__}.")
    close(gradient, tested.gradient, SAME, f"gradients of {name} and of NumPy arrays")
    return close(voltages, tested.voltages, SAME, f"voltages of {name} and of NumPy arrays")


@contextmanager
def _double_jax() -> Iterator[Any]:
    """Yield JAX with float64.

    Raises:
        SkippedError: it is not installed.
    """
    if why := missing("jax"):
        raise SkippedError(why)
    import jax

    config: Any = jax.config
    before = config.jax_enable_x64
    config.update("jax_enable_x64", True)
    try:
        yield jax
    finally:
        config.update("jax_enable_x64", before)


def precision_kept(tested: OperatorUnderTest) -> None:
    """Keeps float32 and float64."""
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
    """Float32 agrees with float64.

    But for rounding.
    """
    sigma, cotangent = (a.astype(np.float32) for a in (tested.sigma, tested.cotangent))
    untouched = np.full_like(sigma[0], tested.sensor.background)
    response = tested.operator.voltages(sigma) - tested.operator.voltages(untouched)
    expected = tested.voltages - tested.background
    said = close(response, expected, SINGLE, "responses to a touch in float32 and float64")
    gradient = tested.operator.vjp(sigma, cotangent)
    close(gradient, tested.gradient, SINGLE, "gradients in float32 and float64")
    return said


def reference_voltages(tested: OperatorUnderTest) -> str:
    """The background gives the untouched sensor."""
    model = forward_model(tested.sensor)
    what = "voltages of the untouched sensor, and those of the model,"
    return close(tested.background, model.voltages(model.background), REFERENCE, what)


def differences(tested: OperatorUnderTest) -> str:
    """The gradient equals central differences.

    That of a misfit, sum (F(sigma) - v)^2 / 2, along random directions.
    """
    sigma, measured = tested.sigma[0], tested.voltages[1]
    gradient = tested.gradient_of(sigma, tested.voltages[0] - measured)

    def misfit(images: Array) -> Array:
        off = tested.voltages_of(images) - measured
        return np.asarray(0.5 * np.sum(off**2, axis=-1))

    ways, what = _directions(tested, sigma), "the gradient and central differences"
    along = np.tensordot(ways, gradient, axes=2)
    return close(along, _differences(misfit, sigma, ways), _allowed(tested), what)


def adjoint(tested: OperatorUnderTest) -> str:
    """The vjp is the adjoint of the Jacobian.

    <J d, g> = <d, J^T g>: J from unit cotangents, differences and the vjp of g.
    """
    sigma, n = tested.sigma[0], tested.sensor.n_measurements
    jacobian = np.concatenate(
        [
            tested.gradient_of(np.repeat(sigma[None], len(part), axis=0), part)
            for part in np.array_split(np.eye(n), -(-n // 32))
        ]
    )
    ways = _directions(tested, sigma)
    change = np.tensordot(ways, jacobian, axes=([1, 2], [1, 2]))
    expected = _differences(tested.voltages_of, sigma, ways)
    said = close(change, expected, _allowed(tested), "J d and central differences")
    weights = tested.random(DIRECTIONS, n)
    images = np.repeat(sigma[None], DIRECTIONS, axis=0)
    back = np.einsum("kij,kij->k", ways, tested.gradient_of(images, weights))
    close(back, np.einsum("km,km->k", change, weights), SAME, "<d, J^T g> and <J d, g>")
    return said


def _directions(tested: OperatorUnderTest, sigma: Array) -> Array:
    """Return random changes (6, H, W) of the image, at most as large as its pixels."""
    return sigma * tested.random(DIRECTIONS, *sigma.shape)


def _differences(function: Callable[[Array], Array], sigma: Array, ways: Array) -> Array:
    """Return derivatives of `function` at `sigma` along `ways`: central differences of order 4."""
    step = 1e-3
    near, far = (
        function(sigma + k * step * ways) - function(sigma - k * step * ways) for k in (1, 2)
    )
    return np.asarray((8 * near - far) / (12 * step))


def _allowed(tested: OperatorUnderTest) -> float:
    return GRADIENT_EXACT if tested.exact else GRADIENT_OTHER


def autograd(tested: OperatorUnderTest) -> str:
    """torch.autograd goes through.

    Through `voltages` and another function.
    """
    import torch

    weights = torch.tensor(tested.cotangent)
    logarithm = torch.tensor(np.log(tested.sigma)).requires_grad_()
    sigma = logarithm.exp()
    try:
        voltages = tested.operator.voltages(sigma)
        (gradient,) = torch.autograd.grad((weights * voltages).sum(), logarithm)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise BrokenError(f"torch cannot differentiate voltages: {reason}") from error
    expected = sigma.detach().numpy() * tested.gradient
    return close(gradient.numpy(), expected, SAME, "torch.autograd and the vjp")


def jax_transforms(tested: OperatorUnderTest) -> str:
    """jax.jit, vmap and grad go through.

    Together, too.
    """
    with _double_jax() as jax:
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


def reciprocity(tested: OperatorUnderTest) -> str:
    """Obeys reciprocity.

    Exchanging the drive and the measuring pair changes at most the sign.
    """
    pattern = tested.sensor.pattern
    pairs = pattern.reciprocal_pairs()
    if not len(pairs):
        raise SkippedError(
            "No pair of electrodes is both driven and measured with, so that nothing is reciprocal."
        )
    voltages = tested.voltages
    violation = (
        voltages[:, pairs[:, 1]] - pattern.reciprocal_signs(pairs) * voltages[:, pairs[:, 0]]
    )
    size_of, what, allowed = (
        (_rms_norm(voltages), "voltages", LAW)
        if tested.exact
        else (_rms_norm(voltages - tested.background), "response to a touch", BROKEN_RECIPROCITY)
    )
    relative = _rms_norm(violation) / size_of
    said = f"reciprocal voltages differ by {relative:.2g} of the {what} ({allowed:g} is allowed)."
    require(relative <= allowed, said)
    return said


def _rms_norm(rows: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


def scaling(tested: OperatorUnderTest) -> str:
    """Obeys the scaling law.

    Ohm's law: F_(z/c)(c sigma) = F_z(sigma) / c with contact impedances z.
    """
    if not tested.exact:
        raise SkippedError("Only operators that say `exact = True` need to obey it.")
    factor = 2.0
    electrodes = tuple(
        replace(e, contact_impedance=e.contact_impedance / factor) for e in tested.sensor.electrodes
    )
    other = tested.make(replace(tested.sensor, electrodes=electrodes))
    scaled = tested.voltages_of(factor * tested.sigma, other)
    what = "voltages at 2 sigma and half the contact impedance, and half of the voltages,"
    return close(scaled, tested.voltages / factor, LAW, what)


def refuses_pixels(tested: OperatorUnderTest) -> None:
    """Refuses pixels that are not above 0."""
    for value in (0.0, -1.0, np.nan, np.inf):
        sigma = tested.sigma.copy()
        sigma[1, 3, 5] = value
        _require_refusal(tested, sigma, tested.cotangent, f"a pixel of {value:g} S/m")


def refuses_grids(tested: OperatorUnderTest) -> None:
    """Refuses another image grid."""
    sigma = tested.sigma
    for shape in (sigma[..., :-1].shape, sigma[:, 1:].shape, (sigma[0].size,)):
        leading = shape[:-2]
        weights = np.ones((*leading, tested.sensor.n_measurements))
        _require_refusal(tested, np.ones(shape), weights, f"conductivity of shape {shape}")


def refuses_precisions(tested: OperatorUnderTest) -> None:
    """Refuses float16 and whole numbers."""
    for name in ("float16", "int64"):
        sigma = np.ones_like(tested.sigma).astype(name)
        _require_refusal(tested, sigma, tested.cotangent, f"conductivity in {name}")


def _require_refusal(tested: OperatorUnderTest, sigma: Any, cotangent: Any, what: str) -> None:
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
            raise BrokenError(
                f"{name} accepts {what}: raise an InputError that says what is wrong."
            )


def refuses_cotangents(tested: OperatorUnderTest) -> None:
    """Refuses cotangents of another shape."""
    n, m = tested.cotangent.shape
    for shape in ((n, m - 1), (n - 1, m), (m,)):
        try:
            tested.operator.vjp(tested.sigma, np.ones(shape))
        except InputError:
            continue
        raise BrokenError(
            f"vjp accepts a cotangent of shape {shape} for {n} images: raise an InputError."
        )
