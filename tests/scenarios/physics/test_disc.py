"""The complete electrode model on a disc, against its series solution.

On a disc the map from current density j on the rim to the potential there is diagonal in Fourier
modes, R / (sigma |k|), times (1 + mu rho^2k) / (1 - mu rho^2k) with a concentric inclusion of
radius rho R and mu = (sigma - sigma_i) / (sigma + sigma_i). Expanding j in Legendre
polynomials on each electrode, whose Fourier coefficients are spherical Bessel functions, turns
z j + u = U_l into a small dense system (Somersalo, Cheney and Isaacson 1992; Demidenko 2011).
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import spherical_jn

from eitbench.scenarios.physics.forward import ForwardModel
from eitbench.scenarios.physics.mesh import triangle_mesh
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

Array = NDArray[np.float64]
RADIUS, WIDTH, IMPEDANCE, BACKGROUND = 0.05, 0.008, 2e-3, 0.7


def disc_sensor(pixels: int) -> Sensor:
    outline = Disc(RADIUS)
    electrodes = even_electrodes(outline, 16, WIDTH, IMPEDANCE, start=0.003)
    return Sensor(
        "disc", outline, electrodes, offset_pattern(16, 3), BACKGROUND, image_shape=(pixels, pixels)
    )


def series_voltages(
    sensor: Sensor,
    inclusion: tuple[float, float] | None = None,
    modes: int = 6000,
    degree: int = 14,
) -> Array:
    """Voltages (M,); `inclusion` is (radius / R, conductivity)."""
    angle = np.array([e.centre / RADIUS for e in sensor.electrodes])
    half = WIDTH / RADIUS / 2
    k = np.arange(1, modes + 1)
    resistance = RADIUS / (BACKGROUND * k)
    if inclusion is not None:
        rho, sigma = inclusion
        mu = (BACKGROUND - sigma) / (BACKGROUND + sigma) * rho ** (2.0 * k)
        resistance *= (1 + mu) / (1 - mu)
    n = np.arange(degree)
    bessel = np.array([2 * spherical_jn(m, k * half) for m in n])
    # phase[l, n, k] = int P_n(t) exp(i k (angle_l + half t)) dt
    phase = np.exp(1j * np.outer(angle, k))[:, None] * (1j**n)[None, :, None] * bessel
    flat = phase.reshape(-1, modes)
    potential = half / np.pi * np.real((flat * resistance) @ flat.conj().T)
    contact = IMPEDANCE * np.diag(np.tile(2 / (2 * n + 1), len(angle)))
    electrode = np.zeros((len(angle) * degree, len(angle)))
    electrode[np.arange(len(angle)) * degree, np.arange(len(angle))] = 1
    # Unknowns: Legendre coefficients of j, then U, with current 2 R half c_0 and sum(U) = 0.
    size = len(angle)
    system = np.block(
        [
            [potential + contact, -2 * electrode],
            [2 * RADIUS * half * electrode.T, np.ones((size, size)) / size],
        ]
    )
    currents = np.vstack([np.zeros((len(potential), size)), np.eye(size) - 1 / size])
    u = np.linalg.solve(system, currents)[len(potential) :]
    src, sink, a, b = sensor.pattern.table.T
    return np.asarray(u[a, src] - u[b, src] - u[a, sink] + u[b, sink])


def test_series_has_converged() -> None:
    sensor = disc_sensor(16)
    coarse, fine = series_voltages(sensor, modes=3000, degree=10), series_voltages(sensor)
    assert np.linalg.norm(coarse - fine) < 1e-6 * np.linalg.norm(fine)


def test_voltages_converge_quadratically_to_the_series() -> None:
    """Solutions of the complete electrode model lie in H^(2-eps): voltages err as h^(2-eps).

    The mesher does not halve every triangle, so the rate is fitted to h = n_nodes^(-1/2).
    """
    exact = series_voltages(disc_sensor(16))
    errors, nodes = [], []
    for pixels in (16, 32, 64, 128):
        sensor = disc_sensor(pixels)
        model = ForwardModel(sensor)
        v = model.voltages(np.full(sensor.image_shape, BACKGROUND))
        errors.append(np.linalg.norm(v - exact) / np.linalg.norm(exact))
        nodes.append(len(model.mesh.nodes))
    rate = -2 * np.polyfit(np.log(nodes), np.log(errors), 1)[0]
    assert errors[-1] < 2e-4
    assert 1.8 < rate < 2.2


@pytest.mark.parametrize("conductivity", [0.05, pytest.param(5.0, marks=pytest.mark.slow)])
def test_concentric_inclusion(conductivity: float) -> None:
    """A circle drawn in pixels is right to first order in their size."""
    exact = series_voltages(disc_sensor(16), (0.5, conductivity)) - series_voltages(disc_sensor(16))
    errors = []
    for pixels in (24, 48, 96):
        sensor = disc_sensor(pixels)
        x, y = sensor.pixel_centres
        sigma = np.where(np.hypot(x, y) < 0.5 * RADIUS, conductivity, BACKGROUND)
        model = ForwardModel(sensor)
        change = model.voltages(sigma) - model.voltages(np.full(sensor.image_shape, BACKGROUND))
        errors.append(np.linalg.norm(change - exact) / np.linalg.norm(exact))
    assert errors[-1] < 0.03
    assert np.log2(errors[0] / errors[-1]) > 2 * 0.8


def test_conductivity_outside_the_disc_is_ignored() -> None:
    sensor = disc_sensor(24)
    model = ForwardModel(sensor)
    sigma = np.full(sensor.image_shape, BACKGROUND)
    elsewhere = np.where(sensor.mask, sigma, np.nan)
    np.testing.assert_array_equal(model.voltages(elsewhere), model.voltages(sigma))
    assert (model.jacobian(sigma)[:, ~sensor.mask] == 0).all()


@pytest.mark.slow
def test_the_mesh_does_not_depend_on_the_last_bits_of_sines(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Processors with other vector units round sines otherwise, which changed meshes."""
    expected = triangle_mesh(disc_sensor(60))
    exact = Disc.point
    for seed in range(3):
        rng = np.random.default_rng(seed)

        def rounded(outline: Disc, arc: Array, rng: np.random.Generator = rng) -> Array:
            points = exact(outline, arc)
            return points * (1 + np.finfo(float).eps * rng.integers(-1, 2, points.shape))

        monkeypatch.setattr(Disc, "point", rounded)
        found = triangle_mesh(disc_sensor(60))
        np.testing.assert_array_equal(found.nodes, expected.nodes)
        np.testing.assert_array_equal(found.elements, expected.elements)
