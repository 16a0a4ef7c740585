"""The exact operator and the linear one: derivatives, the three array libraries, bad input."""

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_info
from torch import Tensor

from eitbench.methods import Operator, operator, register_operator
from eitbench.methods.registry import OPERATOR_REGISTRY, operators
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.outlines import Disc, rectangle
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

Array = NDArray[np.float64]

NAMES = ["fem", "jacobian"]


def square(pixels: int = 12, **changes: Any) -> Sensor:
    outline = rectangle(0.1, 0.1)
    electrodes = even_electrodes(outline, 8, 0.012, 1e-3, start=0.0125)
    made = Sensor("square", outline, electrodes, offset_pattern(8, 2), image_shape=(pixels, pixels))
    return replace(made, **changes)


def disc() -> Sensor:
    electrodes = even_electrodes(Disc(0.05), 8, 0.012, 1e-3)
    return Sensor("disc", Disc(0.05), electrodes, offset_pattern(8, 1), image_shape=(14, 14))


SENSORS: dict[str, Callable[[], Sensor]] = {
    "square": square,
    "odd grid": lambda: square(image_shape=(9, 17)),
    "magnitudes": lambda: square(pattern=replace(offset_pattern(8, 2), magnitudes=True)),
    "disc": disc,
}


def rough(s: Sensor, n: int, seed: int = 0) -> Array:
    """Images whose neighbouring pixels differ by factors up to 5."""
    return np.exp(0.5 * np.random.default_rng(seed).standard_normal((n, *s.image_shape)))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", SENSORS)
def test_vjp_against_central_differences(name: str, kind: str) -> None:
    s = SENSORS[kind]()
    f, sigma, rng = operator(name, s), rough(s, 3), np.random.default_rng(1)
    g = rng.standard_normal((3, s.n_measurements))
    gradient = f.vjp(sigma, g)
    for _ in range(5):
        direction = sigma * rng.standard_normal(sigma.shape)
        step = 1e-5
        ahead, behind = f.voltages(sigma + step * direction), f.voltages(sigma - step * direction)
        expected = np.sum(g * (ahead - behind) / (2 * step), axis=1)
        found = np.sum(gradient * direction, axis=(1, 2))
        # Relative to the terms that the sum is made of, so that chance cancellation does not count.
        scale = np.linalg.norm(gradient, axis=(1, 2)) * np.linalg.norm(direction, axis=(1, 2))
        assert np.abs(found - expected).max() < 1e-6 * scale.max()
    assert np.all(gradient[:, ~s.mask] == 0)
    assert np.abs(gradient[:, s.mask]).max() > 0


@pytest.mark.parametrize("make", [*SENSORS.values(), lambda: sensor("foam16")])
def test_vjp_is_the_transposed_jacobian(make: Callable[[], Sensor]) -> None:
    s = make()
    f, sigma = operator("fem", s), rough(s, 1)[0]
    jacobian = forward_model(s).jacobian(sigma)
    rows = np.stack([f.vjp(sigma, unit) for unit in np.eye(s.n_measurements)])
    assert np.linalg.norm(rows - jacobian) < 1e-12 * np.linalg.norm(jacobian)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["square", "disc"])
def test_torch_gradcheck(name: str, kind: str) -> None:
    s = replace(SENSORS[kind](), image_shape=(6, 6))
    f = operator(name, s)
    sigma = torch.from_numpy(rough(s, 2)).requires_grad_()
    assert torch.autograd.gradcheck(f.voltages, sigma, eps=1e-6, atol=1e-6, rtol=1e-6)


def test_exact_and_linear_agree_to_first_order() -> None:
    """Halving a contrast quarters the difference: both share the value and the slope."""
    s = square()
    exact, linear = operator("fem", s), operator("jacobian", s)
    background = np.full(s.image_shape, s.background)
    np.testing.assert_allclose(exact.voltages(background), linear.voltages(background), rtol=1e-12)
    contrast = 0.02 * np.random.default_rng(0).standard_normal(s.image_shape)
    gaps = [
        np.linalg.norm(
            exact.voltages(background + t * contrast) - linear.voltages(background + t * contrast)
        )
        for t in (1.0, 0.5)
    ]
    assert 3.8 < gaps[0] / gaps[1] < 4.2


@pytest.mark.parametrize("name", NAMES)
def test_three_libraries_one_answer(name: str) -> None:
    s = square()
    f, sigma, g = operator(name, s), rough(s, 4), np.ones((4, s.n_measurements))
    expected, gradient = f.voltages(sigma), f.vjp(sigma, g)

    tensor = torch.from_numpy(sigma).requires_grad_()
    voltages = f.voltages(tensor)
    voltages.sum().backward()  # type: ignore[no-untyped-call]
    np.testing.assert_array_equal(voltages.detach().numpy(), expected)
    assert tensor.grad is not None
    np.testing.assert_allclose(tensor.grad.numpy(), gradient, rtol=1e-12)
    np.testing.assert_allclose(f.vjp(tensor, torch.from_numpy(g)).numpy(), gradient, rtol=1e-12)

    with jax.enable_x64(True):
        array = jnp.asarray(sigma)
        assert array.dtype == jnp.float64
        np.testing.assert_array_equal(f.voltages(array), expected)
        np.testing.assert_array_equal(f.vjp(array, jnp.asarray(g)), gradient)
        pulled = jax.vjp(f.voltages, array)[1](jnp.asarray(g))[0]
        np.testing.assert_array_equal(pulled, gradient)


@pytest.mark.parametrize("name", NAMES)
def test_jit_vmap_and_grad_compose(name: str) -> None:
    s = square()
    f = operator(name, s)
    measured = f.voltages(rough(s, 1, seed=9)[0])

    def loss(image: Any) -> Any:
        return jnp.sum((f.voltages(image) - measured) ** 2)

    sigma = rough(s, 3)
    residual = f.voltages(sigma) - measured
    expected = f.vjp(sigma, 2 * residual)
    with jax.enable_x64(True):
        images = jnp.asarray(sigma)
        np.testing.assert_allclose(
            jax.jit(jax.vmap(loss))(images), np.sum(residual**2, axis=1), rtol=1e-12
        )
        for gradient in (
            jax.vmap(jax.grad(loss)),
            jax.jit(jax.vmap(jax.grad(loss))),
            jax.vmap(jax.jit(jax.grad(loss))),
            jax.grad(lambda batch: jnp.sum(jax.jit(jax.vmap(loss))(batch))),
        ):
            np.testing.assert_allclose(gradient(images), expected, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_float32_costs_rounding_only(name: str) -> None:
    """Below 1e-5 of a touch's response, forward and gradient; the same kind and precision out."""
    foam = sensor("foam16")
    f = operator(name, foam)
    sigma = np.ones((2, 80, 80))
    sigma[0, 30:40, 20:35], sigma[1, 5:20, 60:75] = 0.3, 0.7
    g = np.random.default_rng(0).standard_normal((2, 208))
    exact, gradient = f.voltages(sigma), f.vjp(sigma, g)
    response = np.linalg.norm(exact - f.voltages(np.ones((80, 80))), axis=1)
    found: Any
    for found in (
        f.voltages(sigma.astype(np.float32)),
        f.voltages(torch.tensor(sigma, dtype=torch.float32)),
        jax.jit(f.voltages)(jnp.asarray(sigma, dtype=jnp.float32)),
    ):
        assert str(found.dtype).endswith("float32")
        error = np.linalg.norm(np.asarray(found, dtype=np.float64) - exact, axis=1)
        assert np.all(error < 1e-5 * response)
    single = f.vjp(sigma.astype(np.float32), g.astype(np.float32))
    assert single.dtype == np.float32
    assert np.linalg.norm(single - gradient) < 1e-5 * np.linalg.norm(gradient)


@pytest.mark.nightly
@pytest.mark.skipif(
    sys.platform != "linux", reason="asks Linux for the peak of memory: run on Linux"
)
def test_a_batch_of_256_stays_within_2_gb() -> None:
    """Peak memory of a process that solves and differentiates 256 images of foam16 at once."""
    # Not by getrusage, which counts what the process that starts this one has taken, too.
    program = """
import re, torch
from pathlib import Path
from eitbench.methods import operator
from eitbench.scenarios.catalogue import sensor
sigma = torch.full((256, 80, 80), 0.5, dtype=torch.float64, requires_grad=True)
operator("fem", sensor("foam16")).voltages(sigma).sum().backward()
print(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert int(done.stdout) * 1024 < 2e9


def test_gradient_is_not_kept_where_none_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    s = square()
    f = operator("fem", s)
    monkeypatch.setattr(type(f.model), "voltages_and_fields", None)  # type: ignore[attr-defined]
    sigma = torch.from_numpy(rough(s, 2))
    assert not f.voltages(sigma).requires_grad
    with torch.no_grad():
        assert not f.voltages(sigma.requires_grad_()).requires_grad


BAD_PIXELS = [0.0, -0.2, np.nan, np.inf]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", BAD_PIXELS)
def test_bad_conductivity(name: str, value: float) -> None:
    s = square()
    f, sigma = operator(name, s), rough(s, 2)
    sigma[1, 3, 4] = value
    with pytest.raises(InputError, match="finite and above 0"):
        f.voltages(jnp.asarray(sigma, dtype=jnp.float32))
    with pytest.raises(Exception, match="finite and above 0"):
        np.asarray(jax.jit(f.voltages)(jnp.asarray(sigma, dtype=jnp.float32)))


def test_pixels_outside_the_sensor_do_not_matter() -> None:
    s = disc()
    f, sigma = operator("fem", s), rough(s, 1)[0]
    other = np.where(s.mask, sigma, np.nan)
    np.testing.assert_array_equal(f.voltages(sigma), f.voltages(other))


@pytest.mark.parametrize("name", NAMES)
def test_wrong_grid_and_precision(name: str) -> None:
    s = square()
    f = operator(name, s)
    with pytest.raises(InputError, match=r"needs shape \(\.\.\., 12, 12\), got \(11, 12\)"):
        jax.jit(f.voltages)(jnp.ones((11, 12)))
    good = np.ones((12, 12))
    for given in (
        good.astype(np.complex128),
        torch.ones(12, 12, dtype=torch.bfloat16),
        jnp.ones((12, 12), dtype=jnp.bfloat16),
    ):
        with pytest.raises(InputError, match="would lose accuracy"):
            f.voltages(given)
        with pytest.raises(InputError, match="would lose accuracy"):
            f.vjp(given, np.ones(s.n_measurements))
    with pytest.raises(InputError, match="cotangent"):
        f.vjp(good, np.ones(3))


def test_conductivity_too_uneven_to_solve() -> None:
    s = square()
    sigma = np.full((2, 12, 12), 1e-300)
    sigma[0], sigma[1, :6] = 1.0, 1e300
    with pytest.raises(InputError, match="image 1 cannot be solved"):
        operator("fem", s).voltages(sigma)


@pytest.mark.parametrize("factor", [1e-14, 1e-6, 1e6, 1e14])
def test_accuracy_does_not_depend_on_units(factor: float) -> None:
    """V(c sigma) = V(sigma) / c where contact impedances are divided by c."""
    s = square()
    contacts = tuple(
        replace(e, contact_impedance=e.contact_impedance / factor) for e in s.electrodes
    )
    scaled = replace(s, electrodes=contacts, background=s.background * factor)
    sigma, g = rough(s, 2), np.ones((2, s.n_measurements))
    f, f_scaled = operator("fem", s), operator("fem", scaled)
    np.testing.assert_allclose(
        f_scaled.voltages(factor * sigma) * factor, f.voltages(sigma), rtol=1e-10
    )
    gradient = f_scaled.vjp(factor * sigma, g) * factor**2
    assert np.abs(gradient - f.vjp(sigma, g)).max() < 1e-10 * np.abs(gradient).max()


def test_second_derivatives_are_refused_not_forgotten() -> None:
    s = square()
    sigma = torch.from_numpy(rough(s, 1)).requires_grad_()
    loss = operator("fem", s).voltages(sigma).square().sum()
    (gradient,) = torch.autograd.grad(loss, sigma, create_graph=True)
    with pytest.raises(InputError, match="once, not twice"):
        torch.autograd.grad(gradient.square().sum() + sigma.sum(), sigma)


def test_threads_of_other_libraries_are_left_alone() -> None:
    s = square()
    f, sigma = operator("fem", s), rough(s, 8)
    expected, before = f.vjp(sigma, f.voltages(sigma)), threadpool_info()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: f.vjp(sigma, f.voltages(sigma)), range(8)))
    for gradient in found:
        np.testing.assert_array_equal(gradient, expected)
    assert threadpool_info() == before


def test_an_operator_of_the_wrong_shape_is_refused() -> None:
    class Transposed(Operator):
        def tensor_voltages(self, sigma: Tensor) -> Tensor:
            return sigma.new_ones(self.sensor.n_measurements, len(sigma))

    s = square()
    with pytest.raises(
        InputError, match=r"must return shape \(2, 40\) for 2 images, not \(40, 2\)"
    ):
        Transposed(s).voltages(rough(s, 2))


def test_registry() -> None:
    assert {"fem", "jacobian"} <= set(operators())
    with pytest.raises(InputError, match="Unknown operator 'fme': did you mean 'fem'"):
        operator("fme", square())
    with pytest.raises(InputError, match="The name 'fem' is taken"):

        @register_operator("fem")
        class Impostor(Operator):
            def tensor_voltages(self, sigma: Tensor) -> Tensor:
                return sigma.flatten(1)

    with pytest.raises(InputError, match="not a subclass of Operator"):
        register_operator("int")(int)


def test_an_operator_of_ones_own() -> None:
    try:

        @register_operator("cubed")
        class Cubed(Operator):
            """The sum of cubes."""

            def tensor_voltages(self, sigma: Tensor) -> Tensor:
                return (sigma**3).sum((1, 2))[:, None].expand(-1, self.sensor.n_measurements)

        s = square()
        f, sigma = operator("cubed", s), rough(s, 2)
        g = np.zeros((2, s.n_measurements))
        g[:, 0] = 1.0
        np.testing.assert_allclose(f.vjp(sigma, g), 3 * sigma**2, rtol=1e-12)
        loss = jax.jit(jax.grad(lambda image: f.voltages(image)[0]))
        np.testing.assert_allclose(loss(jnp.asarray(sigma[0])), 3 * sigma[0] ** 2, rtol=1e-5)
    finally:
        OPERATOR_REGISTRY._registered.pop("cubed", None)
