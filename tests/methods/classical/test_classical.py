"""The classical methods against their definitions, and against each other's naive forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import clean_problem, touch

from eitbench.methods import create
from eitbench.methods.classical.gauss_newton import GaussNewtonNoser
from eitbench.methods.classical.linearisation import VARIABLES, Linearisation, Variable
from eitbench.methods.classical.noser import noser_covariance
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import offset_pattern, pair_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes

Array = NDArray[np.float64]
ONE_STEP = ["tikhonov", "noser", "laplacian", "greit"]
ALL = ["back-projection", *ONE_STEP, "tv", "gauss-newton-noser", "gauss-newton-tv"]


def foam(pixels: int = 20, upper: float = 20.0) -> Sensor:
    return replace(sensor("foam16"), image_shape=(pixels, pixels), conductivity_range=(0.05, upper))


def opposition_disc() -> Sensor:
    """A round board that drives opposite electrodes and reports magnitudes only."""
    outline = Disc(0.07)
    pairs = [(i, (i + 8) % 16) for i in range(16)]
    senses = [((j + 1) % 16, j) for j in range(16)]
    pattern = replace(pair_pattern(pairs, senses), magnitudes=True)
    electrodes = even_electrodes(outline, 16, 0.008, 1e-3)
    return Sensor("round", outline, electrodes, pattern, background=0.4, image_shape=(24, 24))


@pytest.mark.parametrize("name", ALL)
def test_the_reference_frame_gives_the_background(name: str) -> None:
    for s in (foam(), opposition_disc()):
        p = clean_problem(s)
        method = create(name)
        method.fit(p)
        image = method.reconstruct(p.reference[None])
        assert image.shape == (1, *s.image_shape)
        np.testing.assert_allclose(image, s.background, atol=1e-9)
        assert method.reconstruct(p.reference[None][:0]).shape == (0, *s.image_shape)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("gain", [1.0, 3e4])
def test_a_touch_is_seen_where_it_is_whatever_the_board_and_its_gain(
    name: str, gain: float
) -> None:
    for s, at in ((foam(), (0.065, 0.04)), (opposition_disc(), (0.02, 0.025))):
        p = clean_problem(s, gain)
        truth = touch(s, at, 0.015, 0.7)
        method = create(name)
        method.fit(p)
        contrast = (
            method.reconstruct(gain * forward_model(s).voltages(truth)[None])[0] - s.background
        )
        weight = np.where(contrast < 0.5 * contrast.min(), -contrast, 0.0)
        x, y = s.pixel_centres
        found = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        assert np.hypot(*(found - at)) < 0.012


@pytest.mark.parametrize("name", ALL)
def test_images_do_not_depend_on_the_unit_of_conductivity(name: str) -> None:
    """A skin of a hundredth of the conductivity has the same image in multiples of it."""
    images = []
    for background in (1.0, 0.01):
        electrodes = tuple(
            replace(e, contact_impedance=e.contact_impedance / background)
            for e in foam().electrodes
        )
        s = replace(foam(12), background=background, electrodes=electrodes)
        method = create(name)
        method.fit(clean_problem(s))
        frame = forward_model(s).voltages(touch(s, (0.065, 0.04), 0.015, 0.6))
        images.append(method.reconstruct(frame[None])[0] / background)
    np.testing.assert_allclose(images[0], images[1], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "parameters", "sentence"),
    [
        ("noser", {"weight": -0.5}, "'weight' is a number above 0, got -0.5"),
        ("noser", {"gain_power": -3.0}, "power of gains at least 0"),
        ("back-projection", {"row_exponent": 1000.0}, "exponent of rows is from 0 to 1"),
        ("noser", {"weight": "NaN"}, "'weight' is a number above 0, got 'NaN'"),
        ("tv", {"weight": 0.0}, "'weight' is a number above 0, got 0.0"),
        ("greit", {"blur": -0.2}, "'blur' is a number above 0, got -0.2"),
        ("gauss-newton-noser", {"steps": 0}, "whole number of steps, 1 at least, got 0"),
        ("gauss-newton-tv", {"steps": 2.5}, "whole number of steps, 1 at least, got 2.5"),
    ],
)
def test_impossible_parameters_are_refused(
    name: str, parameters: dict[str, float], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        create(name, **parameters).fit(clean_problem(foam(12)))


def test_bad_frames_are_refused_in_one_sentence() -> None:
    p = clean_problem(foam(12))
    with pytest.raises(InputError, match="208"):
        p.difference(np.zeros((2, 104)))
    frames = np.tile(p.reference, (3, 1))
    frames[1, 5] = np.nan
    with pytest.raises(InputError, match="Frame 1"):
        p.difference(frames)


@pytest.mark.parametrize("name", ["tv", "gauss-newton-tv", "gauss-newton-noser", "noser"])
def test_bounds_are_kept(name: str) -> None:
    s = foam(16, upper=1.0)
    method = create(name)
    p = clean_problem(s)
    method.fit(p)
    image = method.reconstruct(forward_model(s).voltages(touch(s, (0.05, 0.05), 0.02, 0.05))[None])
    assert image.max() <= 1.0 + 1e-12
    assert image.min() >= 0.05 - 1e-12


def test_noser_is_the_regularised_least_squares_in_pixels() -> None:
    """The measurement-space form equals (J^T J + w C^-1)^-1 J^T dv."""
    s = foam(12)
    p = clean_problem(s)
    frame = forward_model(s).voltages(touch(s, (0.05, 0.06), 0.02, 0.8))
    method = create("noser", weight=0.1)
    method.fit(p)
    image = method.reconstruct(frame[None])[0]
    jacobian = p.jacobian.reshape(208, -1)
    covariance = noser_covariance(jacobian)
    damping = 0.1 * np.trace((jacobian * covariance) @ jacobian.T) / 208
    normal = jacobian.T @ jacobian + damping * np.diag(1 / covariance)
    contrast = np.linalg.solve(normal, jacobian.T @ (frame - p.reference))
    np.testing.assert_allclose(image.ravel(), 1.0 + contrast, atol=1e-8)


def test_gauss_newton_fits_the_data_better_than_one_step() -> None:
    s = foam(20)
    p = clean_problem(s)
    frame = forward_model(s).voltages(touch(s, (0.04, 0.055), 0.018, 0.2))
    misfit = {}
    for name in ("noser", "gauss-newton-noser", "gauss-newton-tv"):
        method = create(name, weight=1e-4)
        method.fit(p)
        predicted = forward_model(s).voltages(method.reconstruct(frame[None])[0])
        misfit[name] = np.linalg.norm(predicted - frame)
    assert misfit["gauss-newton-noser"] < 0.3 * misfit["noser"]
    assert misfit["gauss-newton-tv"] < 0.3 * misfit["noser"]


def test_gauss_newton_steps_lower_the_cost_that_they_are_tested_by() -> None:
    """The first step minimises the linearised cost: along it the slope at the background is -2
    (|J x|^2 / w + x^T C^-1 x), which no cost with another weight of the prior has."""
    s = foam(20)
    p = clean_problem(s)
    frame = forward_model(s).voltages(touch(s, (0.04, 0.055), 0.018, 0.8))
    method = GaussNewtonNoser(weight=0.1)
    method.fit(p)
    target = method._linearisation.data(frame[None])[0] @ method._compression.T + method._expected
    sensitivity, data = method.linearised(np.zeros(400), target)
    jacobian = sensitivity.reshape(len(sensitivity), -1)
    covariance = noser_covariance(method._compression @ method._linearisation.jacobian)
    weight = 0.1 * np.trace((jacobian * covariance) @ jacobian.T) / len(jacobian)
    normal = jacobian.T @ jacobian / weight + np.diag(1 / covariance)
    x = np.linalg.solve(normal, jacobian.T @ data / weight)
    step = 1e-4
    slope = (method._cost(step * x, target) - method._cost(-step * x, target)) / (2 * step)
    expected = -2 * (np.sum((jacobian @ x) ** 2) / weight + x @ (x / covariance))
    assert slope == pytest.approx(expected, rel=1e-3)


def test_greit_keeps_the_area_of_small_targets() -> None:
    """Its images are blurred, but the integral of the contrast is that of the target."""
    s = foam(40)
    p = clean_problem(s)
    method = create("greit", weight=1e-4)
    method.fit(p)
    truth = touch(s, (0.05, 0.05), 0.006, 0.99)
    frame = p.reference + p.jacobian.reshape(208, -1) @ (truth - 1.0).ravel()
    contrast = method.reconstruct(frame[None])[0] - 1.0
    assert contrast.sum() == pytest.approx((truth - 1.0).sum(), rel=0.1)


def test_an_offset_of_four_is_reconstructed_too() -> None:
    s = replace(foam(16), pattern=offset_pattern(16, 4))
    p = clean_problem(s)
    method = create("tv")
    method.fit(p)
    image = method.reconstruct(forward_model(s).voltages(touch(s, (0.05, 0.05), 0.02, 0.7))[None])
    assert image[0, 8, 8] < 0.95


@pytest.mark.parametrize("variable", VARIABLES)
@pytest.mark.parametrize("background", [1.0, 0.3])
def test_the_slope_is_the_derivative_of_conductivity(variable: Variable, background: float) -> None:
    """Against central differences of the images, far from the background on both sides."""
    p = clean_problem(replace(foam(12), background=background))
    of = Linearisation(p, variable, 0.0)
    n = int(p.mask.sum())
    x = np.linspace(of.bounds[0] * 0.9, of.bounds[1] * 0.9, n)
    step = 1e-5
    more, less = (of.images((x + sign * step)[None])[0][p.mask] for sign in (1, -1))
    np.testing.assert_allclose(of.slope(x), (more - less) / (2 * step), rtol=1e-7)


def test_an_unknown_variable_is_refused() -> None:
    with pytest.raises(InputError, match="one of conductivity, clausius-mossotti"):
        create("noser", variable="resistivity").fit(clean_problem(foam(12)))
