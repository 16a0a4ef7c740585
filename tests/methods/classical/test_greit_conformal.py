"""Regions of `greit-conformal` hold as many places as they say, simulated and on a real skin."""

from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.metrics.uncertainty import place_figures
from eitbench.benchmark.tuning.selection import selected_parameters
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

NAME = "greit-conformal"
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
    method = create(NAME)
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


def test_draws_are_spots_where_touches_nearby_were() -> None:
    """Those found nearest have an error of their own; places outside move to the nearest inside."""
    method, problem = fitted(TOUCHES)
    near = np.tile([0.05, 0.05], (DRAWS, 1))
    method._found = np.concatenate([near, near + 0.03])
    method._errors = np.repeat([[0.012, -0.007], [9.0, 9.0]], DRAWS, axis=0)
    errors = method._errors_near(np.array([0.052, 0.05]))
    np.testing.assert_array_equal(errors, method._errors[:DRAWS])
    spots = method._spots(np.array([[0.062, 0.043], [0.2, 0.05]]))
    found = locate(1 - 0.3 * spots, problem.sensor, 1.0)
    pixel = max(problem.sensor.pixel_size)
    np.testing.assert_allclose(found[0], [0.062, 0.043], atol=0.1 * pixel)
    assert 0.1 - 3 * pixel < found[1, 0] < 0.1
    assert abs(found[1, 1] - 0.05) < pixel


def test_errors_move_places_towards_the_true_ones() -> None:
    """Where images are all off to one side, the draws lie on the other side of them."""
    method, problem = fitted(TOUCHES)
    method._errors = method._errors - method._errors.mean(axis=0) + [0.01, 0.0]
    data = load(TOUCHES, "test", 20)
    found = locate(method.reconstruct(data.voltages), data.sensor, problem.background)
    drawn = [
        locate(of, data.sensor, problem.background) for of in method.uncertainty(data.voltages)
    ]
    assert np.median(np.mean(drawn, axis=1)[:, 0] - found[:, 0]) > 0.005
    # Validation touches themselves, with the errors that are theirs.
    fresh, _ = fitted(TOUCHES)
    seen = load(TOUCHES, "validation")
    assert seen.conductivity is not None
    true = locate(seen.conductivity - 1, seen.sensor)
    np.testing.assert_allclose(fresh._found + fresh._errors, true, atol=1e-12)


def test_images_and_parameters_are_those_of_greit() -> None:
    method, problem = fitted(TOUCHES)
    greit = create("greit")
    greit.fit(problem)
    frames = load(TOUCHES, "test", 3).voltages
    np.testing.assert_array_equal(method.reconstruct(frames), greit.reconstruct(frames))
    for name in ("ohmc16", "cam09-04", "noise-50db"):
        found = [selected_parameters(scenario_by_name(name), of) for of in ("greit", NAME)]
        assert found[0] is not None
        assert found[0] == found[1]


def test_few_touches_are_refused() -> None:
    with pytest.raises(InputError, match="has 5 touches whose place is known and seen, and 10 are"):
        fitted(TOUCHES.model_copy(update={"name": "few", "validation": 5}))
