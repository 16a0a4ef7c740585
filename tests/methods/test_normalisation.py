"""Differences of the nominal sensor: of boards with known gains and faults, and of real skins."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import clean_problem, foam, touch

from eitbench.methods import Problem, create
from eitbench.methods.problem import no_split
from eitbench.scenarios import forward_model, sensor
from eitbench.scenarios.phantoms.contacts import locate
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.similarity import fit_similarity

Array = NDArray[np.float64]
SENSOR = foam((24, 24))
MODEL = forward_model(SENSOR)
FRAME = MODEL.voltages(MODEL.background)
TOUCHES = np.stack(
    [MODEL.voltages(touch(SENSOR, at)) for at in ((0.065, 0.04), (0.03, 0.06), (0.08, 0.08))]
)
CHANGES = TOUCHES - FRAME
GAINS = np.exp(0.6 * np.random.default_rng(1).standard_normal(len(FRAME)))
DEAD = (SENSOR.pattern.table == 5).any(axis=1)


def error(found: Array, true: Array = CHANGES) -> float:
    """Of differences up to a factor, which the median gain leaves open, relative to the true."""
    factor = np.vdot(found, true) / np.vdot(found, found)
    return float(np.linalg.norm(factor * found - true) / np.linalg.norm(true))


def test_gains_are_taken_out() -> None:
    problem = Problem(SENSOR, GAINS * FRAME, no_split)
    by_power = [error(problem.difference(GAINS * TOUCHES, p)) for p in (0.0, 0.5, 1.0)]
    assert by_power[0] > 0.5
    assert by_power[1] < 0.7 * by_power[0]
    assert by_power[2] < 0.5 * by_power[0]


@pytest.mark.parametrize("gain_power", [0.0, 0.5, 1.0])
def test_where_only_differences_are_known_nothing_is_changed(gain_power: float) -> None:
    """Then the reference frame is the model's, in units of its own."""
    problem = clean_problem(SENSOR, gain=40.0)
    np.testing.assert_array_equal(
        problem.difference(40 * TOUCHES, gain_power),
        (40 * TOUCHES - problem.reference) / problem.gain,
    )


def test_what_a_dead_electrode_spoils_comes_back_from_the_others() -> None:
    live = np.where(DEAD, 0.0, 1.0)
    problem = Problem(SENSOR, 3 * live * FRAME, no_split)
    assert problem.gain == pytest.approx(3)  # the zeros do not count
    found = problem.difference(3 * live * TOUCHES)
    np.testing.assert_allclose(found[:, ~DEAD], CHANGES[:, ~DEAD], atol=1e-12)
    assert error(found[:, DEAD], CHANGES[:, DEAD]) < 0.3
    # Whatever the dead values read.
    wild = 3 * live * TOUCHES + DEAD * np.random.default_rng(0).standard_normal(TOUCHES.shape)
    np.testing.assert_allclose(problem.difference(wild), found, atol=1e-12)
    # A later reference frame has its own faults.
    problem.reference = 3 * FRAME
    np.testing.assert_allclose(problem.difference(3 * TOUCHES), CHANGES, atol=1e-12)


def test_gains_and_faults_together() -> None:
    live = np.where(DEAD, 0.0, GAINS)
    problem = Problem(SENSOR, live * FRAME, no_split)
    both = error(problem.difference(live * TOUCHES, 1.0))
    assert both < 0.5 * error(Problem(SENSOR, GAINS * FRAME, no_split).difference(GAINS * TOUCHES))


@pytest.mark.parametrize("method", ["noser", "tv", "greit"])
def test_images_with_a_dead_electrode_are_nearly_those_without(method: str) -> None:
    """What is lost is less than a third of what frames with zeros would lose."""
    live = np.where(DEAD, 0.0, 1.0)
    fitted = create(method)
    problem = clean_problem(SENSOR)
    fitted.fit(problem)
    whole = fitted.reconstruct(TOUCHES)
    zeros = fitted.reconstruct(np.where(DEAD, FRAME, TOUCHES))
    problem.reference = live * FRAME
    lost = np.linalg.norm(fitted.reconstruct(live * TOUCHES) - whole)
    assert lost < np.linalg.norm(zeros - whole) / 3


@pytest.mark.parametrize(("recording", "least"), [("ohmc16", 0.75), ("superpose500", 0.75)])
def test_presses_of_a_real_skin_are_found_nearer(
    recording: str, least: float, recorded_data: Path
) -> None:
    """Registered on validation presses, with one weight; test presses judge."""
    frames = read_recording(recording)
    skin = replace(sensor(recording), image_shape=(32, 32))
    places = frames.samples[["x_m", "y_m"]].to_numpy()
    known = (frames.samples["split"] == "validation").to_numpy()
    problem = Problem(skin, frames.reference, no_split)
    errors = []
    for gain_power in (0.0, 1.0):
        method = create("noser", weight=1.0, gain_power=gain_power)
        method.fit(problem)
        found = locate(np.asarray(method.reconstruct(frames.voltages)) - skin.background, skin)
        register = fit_similarity(found[known], places[known])
        assert register is not None
        errors.append(float(np.nanmedian(np.hypot(*(register(found) - places)[~known].T))))
    assert errors[1] < least * errors[0]
