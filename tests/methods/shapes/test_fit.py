"""Fits of shapes to images and frames, through the exact model."""

import numpy as np
import pytest
from tests.support.small_sensors import clean_problem, foam

from eitbench.methods.shapes.fit import EDGE, FrameModel, fit_frame, fit_image
from eitbench.methods.shapes.parameters import Parameters
from eitbench.scenarios.phantoms.families import FAMILIES

SENSOR = foam((40, 40))
PROBLEM = clean_problem(SENSOR)
MODEL = FrameModel(PROBLEM)
TRUTHS = {
    "circle": [0.6, 0.45, 0.15, 0.5],
    "ring": [0.5, 0.55, 0.25, 0.5, 0.6],
    "rectangle": [0.5, 0.5, 0.3, 0.3, 0.2, 0.6],
    "two-circles": [0.3, 0.35, 0.12, 0.4, 0.7, 0.65, 0.14, 0.7],
}


def test_the_combinations_have_the_noise_of_one_measurement() -> None:
    noise = np.random.default_rng(0).standard_normal((4000, len(PROBLEM.reference)))
    combined = MODEL.data(noise)
    assert combined.shape[1] == MODEL.count < noise.shape[1]
    assert combined.std(axis=0) == pytest.approx(1, abs=0.06)


def test_differences_and_their_derivative_are_those_of_the_model() -> None:
    parameters = Parameters(FAMILIES["circle"], SENSOR)
    image = parameters.image(np.array(TRUTHS["circle"]), EDGE)
    sigma = image * PROBLEM.background
    exact = PROBLEM.model.voltages(sigma) - PROBLEM.background_voltages
    assert MODEL.differences(image) == pytest.approx(MODEL.data(exact), abs=1e-12)

    about = MODEL.linearised(image)
    assert about.differences(image) == pytest.approx(MODEL.data(exact), abs=1e-12)
    change = np.zeros_like(image)
    change[16:20, 22:26] = 1e-4  # within the disc, away from the ends of the range
    ahead, behind = MODEL.differences(image + change), MODEL.differences(image - change)
    predicted = (about.differences(image + change) - about.differences(image - change)) / 2
    assert predicted == pytest.approx((ahead - behind) / 2, rel=1e-5, abs=1e-11)
    assert about.times(change.ravel()) == pytest.approx(predicted, rel=1e-6, abs=1e-14)


def test_noise_is_what_reciprocal_measurements_differ_by() -> None:
    """The estimate has a spread of sqrt(2 / (M - K)), and sees nothing of the conductivity."""
    image = Parameters(FAMILIES["circle"], SENSOR).image(np.array(TRUTHS["circle"]))
    clean = PROBLEM.model.voltages(image * PROBLEM.background) - PROBLEM.background_voltages
    energy = float(clean @ clean)
    assert MODEL.noise(clean) < 1e-14 * energy
    rng = np.random.default_rng(4)
    noise = 0.01 * np.sqrt(energy / len(clean)) * rng.standard_normal((200, len(clean)))
    found = np.array([MODEL.noise(clean + part) for part in noise])
    expected = 1e-4 * energy / len(clean) * MODEL.count
    spread = np.sqrt(2 / MODEL.repeated)
    assert found.mean() == pytest.approx(expected, rel=4 * spread / np.sqrt(200))
    assert found.std() == pytest.approx(spread * expected, rel=0.2)


@pytest.mark.parametrize("name", TRUTHS)
def test_moved_edges_count_as_discs_do(name: str) -> None:
    """Where edges move by a pixel or two, that errs much less than a linear change of pixels."""
    parameters, truth = Parameters(FAMILIES[name], SENSOR), np.array(TRUTHS[name])
    image = parameters.image(truth)
    about = MODEL.linearised(image)
    rng = np.random.default_rng(5)
    errors = []
    for _ in range(10):
        moved = parameters.image(truth + 3 * rng.standard_normal(len(truth)) * parameters.step)
        exact = MODEL.differences(moved)
        linear = about.predicted + about.times((moved - image).ravel())
        errors.append([np.linalg.norm(p - exact) for p in (about.differences(moved), linear)])
    ours, linear = np.mean(errors, axis=0)
    assert ours < 0.6 * linear


@pytest.mark.parametrize("name", TRUTHS)
def test_a_fit_finds_the_shape_again(name: str) -> None:
    """Data of a soft image, from 1 to 4 of the small steps away, leave nothing unexplained."""
    parameters, truth = Parameters(FAMILIES[name], SENSOR), np.array(TRUTHS[name])
    rng = np.random.default_rng(3)
    start = truth + rng.choice([-1, 1], len(truth)) * rng.uniform(1, 4) * parameters.step
    image = parameters.image(truth, EDGE)
    assert fit_image(parameters, start, image, 40).vector == pytest.approx(truth, abs=2e-3)
    data = MODEL.differences(image)
    found = fit_frame(parameters, start, MODEL, data, 40)
    assert np.sqrt(found.error) < 1e-3 * np.linalg.norm(data)
    assert np.abs(parameters.image(found.vector, EDGE) - image).mean() < 2e-3


def test_parameters_stay_within_the_family() -> None:
    """A disc that is larger than any of the family, and darker."""
    parameters = Parameters(FAMILIES["circle"], SENSOR)
    data = MODEL.differences(parameters.image(np.array([0.5, 0.5, 0.3, 0.07]), EDGE))
    found = fit_frame(parameters, np.array([0.5, 0.5, 0.2, 0.2]), MODEL, data, 20)
    assert parameters.within(found.vector[None]).all()
    assert found.vector[2] == parameters.high[2]
