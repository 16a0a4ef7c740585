"""Bounds of a design against the exact model, simulated estimates and known symmetries."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import least_squares

from eitbench.benchmark.design.bounds import (
    SEEN,
    Noise,
    Touch,
    WhitenedJacobian,
    changes_and_derivatives,
    lattice,
    maps,
    noise_of,
    whitened,
    whitened_jacobian,
)
from eitbench.benchmark.design.designs import default_touch
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.patterns import offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes, foam16

ROW, COLUMN = 10, 26
TOUCH = Touch(0.008, -0.3)


@pytest.fixture(scope="module")
def small() -> Sensor:
    return replace(foam16(), image_shape=(40, 40))


@pytest.fixture(scope="module")
def quiet(small: Sensor) -> WhitenedJacobian:
    return whitened_jacobian(small, noise_of(small, 90.0))


def image(sensor: Sensor, x: float, y: float, strength: float, radius: float) -> Array:
    """Conductivity (H, W) of a touch, written down apart from the module."""
    at_x, at_y = sensor.pixel_centres
    distance = np.hypot(at_x - x, at_y - y)
    peak = strength / (np.pi * radius**2)
    return np.asarray(sensor.background + peak * np.exp(-((distance / radius) ** 2)))


def parameters(sensor: Sensor, contrast: float) -> Array:
    x, y = (centres[ROW, COLUMN] for centres in sensor.pixel_centres)
    strength = sensor.background * contrast * np.pi * TOUCH.radius**2
    return np.array([x, y, strength, TOUCH.radius])


def test_derivatives_are_those_of_the_exact_model(small: Sensor) -> None:
    """Finite differences of exact frames of a faint touch, at noise that whitens by a factor."""
    faint = Touch(TOUCH.radius, -1e-4)
    noise = Noise(1e-3)
    of = whitened_jacobian(small, noise)
    at = np.array([ROW]), np.array([COLUMN])
    change, derivatives = (part[0, 0] for part in changes_and_derivatives(of, faint, *at))
    model, centre = forward_model(small), parameters(small, faint.contrast)
    steps = [1e-2 * faint.radius, 1e-2 * faint.radius, 1e-2 * centre[2], 1e-2 * faint.radius]
    exact = []
    for k, step in enumerate(steps):
        frames = [
            model.voltages(image(small, *(centre + sign * step * np.eye(4)[k]))) for sign in (1, -1)
        ]
        exact.append((frames[0] - frames[1]) / 2e-2)
    touched = model.voltages(image(small, *centre)) - model.voltages(model.background)
    white = np.column_stack([*exact, touched]) / (np.sqrt(2) * noise.std)
    ours = np.column_stack([derivatives, change])
    # Whitened frames are turned: their inner products remain.
    expected = white.T @ white
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs(ours.T @ ours - expected).max() < 2e-3 * scale.max()
    assert (np.abs(ours.T @ ours - expected) / scale).max() < 2e-3


def test_a_maximum_likelihood_fit_attains_the_bound_and_does_not_beat_it(
    quiet: WhitenedJacobian,
) -> None:
    """The variance of 300 fitted places lies within the 99.9 % interval of chi-squared."""
    found = maps(quiet, TOUCH)
    sensor, draws = quiet.sensor, 300
    row = int(np.argmin(np.abs(found.y - sensor.pixel_centres[1][ROW, 0])))
    column = int(np.argmin(np.abs(found.x - sensor.pixel_centres[0][0, COLUMN])))
    strength = parameters(sensor, TOUCH.contrast)[2]
    truth = np.array([found.x[column], found.y[row], strength, TOUCH.radius])
    flat = quiet.rows.reshape(len(quiet.rows), -1)

    def frame(p: Array) -> Array:
        x, y, log_strength, log_radius = p * np.array([TOUCH.radius, TOUCH.radius, 1, 1])
        touched = image(
            sensor, truth[0] + x, truth[1] + y, strength * np.exp(log_strength),
            TOUCH.radius * np.exp(log_radius),
        )  # fmt: skip
        return np.asarray(flat @ (touched - sensor.background).ravel())

    clean, rng = frame(np.zeros(4)), np.random.default_rng(5)
    fits = []
    for _ in range(draws):
        seen = clean + rng.standard_normal(clean.shape)

        def misfit(parameters: Array, seen: Array = seen) -> Array:
            return frame(parameters) - seen

        fits.append(least_squares(misfit, np.zeros(4)).x)
    bound = found.covariance[row, column]
    assert found.place[row, column] == pytest.approx(
        TOUCH.radius * np.sqrt(bound[0, 0] + bound[1, 1])
    )
    low, high = (stats.chi2.ppf(q, draws - 1) / (draws - 1) for q in (0.0005, 0.9995))
    ratios = np.var(fits, axis=0, ddof=1) / np.diag(bound)
    assert (ratios > low).all()
    assert (ratios < high).all()


def test_the_optimal_test_has_the_rates_that_z_promises(quiet: WhitenedJacobian) -> None:
    at = np.array([ROW]), np.array([COLUMN])
    change = changes_and_derivatives(quiet, TOUCH, *at)[0][0, 0]
    change *= SEEN / np.linalg.norm(change)  # the smallest touch that is detected
    rng, draws = np.random.default_rng(1), 20000
    noise = rng.standard_normal((draws, len(change)))
    score = noise @ change / np.linalg.norm(change)
    threshold = stats.norm.isf(0.01)
    assert np.mean(score > threshold) == pytest.approx(0.01, abs=0.003)
    assert np.mean(score + np.linalg.norm(change) > threshold) == pytest.approx(0.9, abs=0.009)


def test_bounds_follow_noise_and_the_symmetry_of_the_sensor(small: Sensor) -> None:
    # An odd number of pixels: the lattice has the symmetry of the square.
    small = replace(small, image_shape=(39, 39))
    quiet, loud = (maps(whitened_jacobian(small, Noise(std)), TOUCH) for std in (1e-5, 1e-4))
    np.testing.assert_allclose(loud.place, 10 * quiet.place, rtol=1e-6)
    np.testing.assert_allclose(quiet.detectability, 10 * loud.detectability, rtol=1e-6)
    np.testing.assert_allclose(loud.smallest, 10 * quiet.smallest, rtol=1e-6)
    free = np.isfinite(quiet.place)
    assert (loud.two_point[free] >= quiet.two_point[free]).all()
    np.testing.assert_allclose(quiet.place, np.rot90(quiet.place), rtol=1e-5)
    np.testing.assert_allclose(quiet.two_point, np.rot90(quiet.two_point), rtol=1e-4)


def test_any_covariance_whitens(small: Sensor) -> None:
    """The norm of a whitened change is that of the quadratic form, worked out anew."""
    model, rng = forward_model(small), np.random.default_rng(6)
    m = small.n_measurements
    mixed = np.eye(m) + 0.1 * rng.normal(size=(m, m))
    covariance = mixed @ mixed.T
    image = rng.normal(size=small.image_shape) * small.mask
    change = model.jacobian(model.background).reshape(m, -1) @ image.ravel()
    rows = whitened(small, covariance).rows
    assert len(rows) == m / 2
    assert np.sum(np.tensordot(rows, image) ** 2) == pytest.approx(
        change @ np.linalg.inv(covariance) @ change, rel=1e-6
    )
    for wrong in (np.ones((m, m)), np.eye(m - 1)):
        with pytest.raises(InputError, match="positive definite"):
            whitened(small, wrong)


def test_drift_makes_every_bound_worse_and_hides_itself(small: Sensor) -> None:
    still, drifting = (
        maps(whitened_jacobian(small, Noise(1e-4, drift)), TOUCH) for drift in (0, 0.02)
    )
    free = np.isfinite(still.place)
    for name in ("place", "strength", "smallest"):
        assert (getattr(drifting, name)[free] >= getattr(still, name)[free] * (1 - 1e-9)).all()
    # z of an even change of the whole sensor is that of its size over its drift, not of the noise.
    of = whitened_jacobian(small, Noise(1e-9, 0.02))
    even = np.full(small.image_shape, 0.01 * small.background)
    assert np.linalg.norm(of.rows.reshape(len(of.rows), -1) @ even.ravel()) == pytest.approx(
        0.5, rel=1e-3
    )


def test_two_touches_at_the_bound_are_told_apart_by_what_one_touch_leaves(
    quiet: WhitenedJacobian,
) -> None:
    """The bound against a least-squares projection of frames of two touches, written anew."""
    louder = replace(quiet, rows=quiet.rows / 30)
    found = maps(louder, TOUCH)
    sensor = quiet.sensor
    row, column = len(found.y) // 2, len(found.x) // 2
    x, y, bound = found.x[column], found.y[row], found.two_point[row, column]
    assert np.isfinite(bound)
    flat = louder.rows.reshape(len(louder.rows), -1)
    strength = parameters(sensor, TOUCH.contrast)[2]

    def frame(x: float, y: float, q: float, r: float) -> Array:
        return np.asarray(flat @ (image(sensor, x, y, q, r) - sensor.background).ravel())

    centre, r = np.array([x, y, strength, TOUCH.radius]), TOUCH.radius
    step = 1e-4 * np.diag([r, r, strength, r])
    tangents = np.column_stack([frame(*(centre + s)) - frame(*(centre - s)) for s in step])
    left = []
    for angle in np.deg2rad([0, 45, 90, 135]):
        a = bound / 2 * np.array([np.cos(angle), np.sin(angle)])
        halves = [frame(x + s * a[0], y + s * a[1], strength / 2, r) for s in (1, -1)]
        extra = sum(halves) - frame(*centre)
        left.append(
            np.linalg.norm(extra - tangents @ np.linalg.lstsq(tangents, extra, rcond=None)[0])
        )
    assert min(left) == pytest.approx(SEEN, rel=0.05)


def test_the_default_touch_is_one_that_the_pixels_can_show() -> None:
    coarse = replace(foam16(), image_shape=(16, 20))
    assert default_touch(foam16()).radius == pytest.approx(0.005)
    assert default_touch(coarse).radius == pytest.approx(1.5 * 0.1 / 16)
    assert all(map(len, lattice(coarse, default_touch(coarse).radius)))


@pytest.mark.parametrize(("radius", "words"), [(0.001, "too small"), (0.06, "no room")])
def test_a_touch_that_does_not_fit_is_refused(
    quiet: WhitenedJacobian, radius: float, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        maps(quiet, Touch(radius))


@pytest.mark.parametrize(("radius", "contrast"), [(0.0, -0.3), (0.01, 0.0), (0.01, -1.0)])
def test_an_impossible_touch_is_refused(radius: float, contrast: float) -> None:
    with pytest.raises(InputError):
        Touch(radius, contrast)


@pytest.mark.parametrize("offset", [1, 2])
def test_what_too_few_measurements_do_not_tell_has_no_bound(small: Sensor, offset: int) -> None:
    """With four electrodes one or two measurements are independent; a touch has four unknowns."""
    electrodes = even_electrodes(small.outline, 4, 0.01, 1e-3, start=0.05)
    few = replace(small, electrodes=electrodes, pattern=offset_pattern(4, offset))
    found = maps(whitened_jacobian(few, noise_of(few, 60.0)), TOUCH)
    known = np.isfinite(found.detectability)
    assert known.any()
    for bound in (found.place, found.strength, found.size):
        assert np.isposinf(bound[known]).all()
