"""Regions of `greit-conformal` hold as many places as they say, simulated and on a real skin."""

from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.metrics.uncertainty import place_figures
from eitbench.methods import Problem, create
from eitbench.methods.classical.greit_conformal import GreitConformal
from eitbench.methods.method import DRAWS
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load, same_reference
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.similarity import Similarity, fit_similarity
from eitbench.scenarios.suites.scenario import Scenario, SimulatedScenario, SplitNoise
from eitbench.scenarios.suites.suite import scenario_by_name

TOUCHES = SimulatedScenario(
    name="touches", image_shape=(24, 24), families=("circle",),
    noise=SplitNoise(validation=35.0, test=35.0), train=0, validation=150, test=150,
)  # fmt: skip


def fitted(scenario: Scenario) -> tuple[GreitConformal, Problem]:
    """The method, and the problem that it is fitted to."""
    validation = load(scenario, "validation")
    problem = Problem(
        scenario.nominal_sensor, validation.references[0], lambda s, n: load(scenario, s, n)
    )
    method = create("greit-conformal")
    assert isinstance(method, GreitConformal)
    method.fit(problem)
    return method, problem


def shares(method: GreitConformal, problem: Problem, data: Dataset, true: Array) -> list[float]:
    """Share of the true places (n, 2) of `data` in their 50, 80 and 95 % regions."""
    places = []
    for rows in same_reference(data.references):
        problem.reference = data.references[rows.start]
        for draws in method.uncertainty(data.voltages[rows]):
            places.append(locate(draws, data.sensor, problem.background))
    figures = place_figures(np.array(places), true)
    return [float(figures[f"place_coverage_{level}"].mean()) for level in (50, 80, 95)]


def test_regions_hold_as_many_simulated_touches_as_they_say() -> None:
    """Of 150 touches a share of 80 % is known to 3 %."""
    method, problem = fitted(TOUCHES)
    data = load(TOUCHES, "test")
    assert data.conductivity is not None
    found = shares(method, problem, data, locate(data.conductivity - 1, data.sensor))
    np.testing.assert_allclose(found, [0.5, 0.8, 0.95], atol=0.11)


def test_regions_hold_as_many_real_presses_as_they_say(recorded_data: Path) -> None:
    """Of 400 presses a share of 80 % is known to 2 %, if they are like those of validation."""
    scenario = scenario_by_name("ohmc16")
    method, problem = fitted(scenario)
    first, data = load(scenario, "validation"), load(scenario, "test")
    places = [of.samples[["x_m", "y_m"]].to_numpy() for of in (first, data)]
    images = method.reconstruct(first.voltages)
    register = fit_similarity(locate(images, first.sensor, problem.background), places[0])
    assert isinstance(register, Similarity)
    found = shares(method, problem, data, register.inverse(places[1]))
    np.testing.assert_allclose(found, [0.5, 0.8, 0.95], atol=0.1)


def test_an_image_is_moved_by_the_errors_of_validation_touches() -> None:
    method, problem = fitted(TOUCHES)
    error = np.array([0.012, -0.007])
    method._errors = np.tile(error, (DRAWS, 1))
    x, y = problem.sensor.pixel_centres
    away = np.hypot(x - 0.045, y - 0.05)
    image = 1 - 0.4 * np.exp(-((away / 0.012) ** 2))
    draws = np.empty((1, *image.shape))
    method._move(image, np.array([[0.045, 0.05]]) + error, draws)
    half_a_pixel = 0.5 * max(problem.sensor.pixel_size)
    np.testing.assert_allclose(
        locate(draws, problem.sensor, 1.0)[0], [0.057, 0.043], atol=half_a_pixel
    )
    assert abs((1 - draws).sum() / (1 - image).sum() - 1) < 0.01
    # Places outside are taken for the nearest ones inside, as far as the rim leaves any image.
    method._move(image, np.array([[0.2, 0.05]]), draws)
    (place,) = locate(draws, problem.sensor, 1.0)
    assert 0.085 < place[0] < 0.1
    assert abs(place[1] - 0.05) < 3 * half_a_pixel


def test_few_touches_are_refused() -> None:
    with pytest.raises(InputError, match="has 5 touches whose place is known and seen, and 10 are"):
        fitted(TOUCHES.model_copy(update={"name": "few", "validation": 5}))
