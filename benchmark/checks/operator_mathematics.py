"""Checks of the mathematics of an operator: derivatives, reciprocity, scaling."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from eitbench.benchmark.checks.harness import SkippedError, require
from eitbench.benchmark.checks.operator_interface import SAME
from eitbench.benchmark.checks.operator_under_test import OperatorUnderTest, close
from eitbench.scenarios.physics.forward import forward_model

Array = NDArray[np.float64]

# Allowed relative difference to the model's voltages of the untouched sensor.
REFERENCE = 0.1
# Laws that an exact operator obeys to rounding, relative to the voltages.
LAW = 1e-9
# Others may break reciprocity by this part of the response to a touch.
BROKEN_RECIPROCITY = 0.1
# Gradients against differences; networks with kinks have no derivative there.
GRADIENT_EXACT, GRADIENT_OTHER = 1e-6, 1e-4
DIRECTIONS = 6


def reference_voltages(tested: OperatorUnderTest) -> str:
    """Require the voltages of the untouched sensor for the background."""
    model = forward_model(tested.sensor)
    return close(
        tested.background,
        model.voltages(model.background),
        REFERENCE,
        "voltages of the background and the model's",
    )


def differences(tested: OperatorUnderTest) -> str:
    """Require the gradient of a misfit, sum (F(sigma) - v)^2 / 2, along random directions."""
    sigma, measured = tested.sigma[0], tested.voltages[1]
    gradient = tested.gradient_of(sigma, tested.voltages[0] - measured)

    def misfit(images: Array) -> Array:
        off = tested.voltages_of(images) - measured
        return np.asarray(0.5 * np.sum(off**2, axis=-1))

    ways = _directions(tested, sigma)
    along = np.tensordot(ways, gradient, axes=2)
    return close(along, _differences(misfit, sigma, ways), _allowed(tested), _GRADIENTS)


_GRADIENTS = "the gradient and central differences"


def adjoint(tested: OperatorUnderTest) -> str:
    """Require <J d, g> = <d, J^T g>: J from unit cotangents, differences and the vjp of g."""
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
    """Require that `torch.autograd` differentiates through `voltages` and another function."""
    import torch

    weights = torch.tensor(tested.cotangent)
    logarithm = torch.tensor(np.log(tested.sigma)).requires_grad_()
    sigma = logarithm.exp()
    try:
        voltages = tested.operator.voltages(sigma)
        (gradient,) = torch.autograd.grad((weights * voltages).sum(), logarithm)
    except RuntimeError as error:
        require(False, f"torch cannot differentiate voltages: {str(error).splitlines()[0]}")
        raise
    expected = sigma.detach().numpy() * tested.gradient
    return close(gradient.numpy(), expected, SAME, "torch.autograd and the vjp")


def reciprocity(tested: OperatorUnderTest) -> str:
    """Require reciprocity: exchanging the drive and the measuring pair changes at most the sign."""
    pattern = tested.sensor.pattern
    pairs = pattern.reciprocal_pairs()
    if not len(pairs):
        raise SkippedError("The drive pattern measures no pair both ways.")
    voltages = tested.voltages
    violation = (
        voltages[:, pairs[:, 1]] - pattern.reciprocal_signs(pairs) * voltages[:, pairs[:, 0]]
    )
    size_of, what, allowed = (
        (_rms_norm(voltages), "voltages", LAW)
        if tested.exact
        else (tested.response, "response to a touch", BROKEN_RECIPROCITY)
    )
    relative = _rms_norm(violation) / size_of
    said = f"reciprocal voltages differ by {relative:.2g} of the {what} ({allowed:g} is allowed)."
    require(relative <= allowed, said)
    return said


def _rms_norm(rows: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))


def scaling(tested: OperatorUnderTest) -> str:
    """Require Ohm's law: F_(z/c)(c sigma) = F_z(sigma) / c with contact impedances z."""
    if not tested.exact:
        raise SkippedError("Only exact operators need to obey it; this one is not (`exact`).")
    factor = 2.0
    electrodes = tuple(
        replace(e, contact_impedance=e.contact_impedance / factor) for e in tested.sensor.electrodes
    )
    other = tested.make(replace(tested.sensor, electrodes=electrodes))
    scaled = tested.voltages_of(factor * tested.sigma, other)
    return close(scaled, tested.voltages / factor, LAW, "V of z/2 at 2 sigma and V/2")
