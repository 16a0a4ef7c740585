"""A problem whose reference frame is measured anew: gain, differences, and images of sessions."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import clean_problem, foam, no_split, touch

from eitbench.methods import Method, Problem, create
from eitbench.methods.method import reconstructed
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.suites.scenario import TOUCHES, SimulatedScenario, SplitNoise

Array = NDArray[np.float64]

NOISY = SimulatedScenario(
    name="noisy",
    image_shape=(12, 12),
    families=("circle",),
    noise=SplitNoise(test=40),
    train=0,
    validation=0,
    test=7,
)


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Three sessions, the last of one touch."""
    return load(NOISY)


def test_gain_and_differences_are_those_of_the_latest_reference_frame() -> None:
    s = foam()
    model = forward_model(s)
    frame, problem = model.voltages(touch(s))[None], clean_problem(s)
    expected = frame - problem.background_voltages
    assert problem.gain == pytest.approx(1)
    problem.reference = 250 * model.voltages(model.background)
    assert problem.gain == pytest.approx(250)
    np.testing.assert_allclose(problem.difference(250 * frame), expected, atol=1e-12)


def test_a_later_reference_frame_is_held_to_the_same_rules() -> None:
    problem = clean_problem(foam())
    with pytest.raises(InputError):
        problem.reference = problem.reference[:-1]
    with pytest.raises(InputError):
        problem.reference = np.nan * problem.reference
    problem.reference = -problem.reference
    with pytest.raises(InputError, match="does not match the sensor's drive pattern"):
        problem.difference(problem.reference[None])


def test_differences_of_data_are_to_their_own_reference_frames(data: Dataset) -> None:
    """In the units of any board, and each as if its reference frame were the problem's."""
    assert len(np.unique(data.references, axis=0)) == 3
    gains = np.repeat([1.0, 40.0, 3.0], TOUCHES)[: len(data), None]
    boards = replace(data, voltages=gains * data.voltages, references=gains * data.references)
    problem = Problem(data.sensor, data.references[0], no_split)
    found = problem.differences(boards)
    np.testing.assert_array_equal(problem.reference, data.references[0])
    for frame, reference, difference in zip(data.voltages, data.references, found, strict=True):
        problem.reference = reference
        np.testing.assert_allclose(difference, problem.difference(frame[None])[0], atol=1e-12)


class Watcher(Method):
    """Notes the frames and reference frames that it is given."""

    def fit(self, problem: Problem) -> None:
        self.problem = problem
        self.given: list[tuple[Array, Array]] = []

    def reconstruct(self, voltages: Array) -> Array:
        self.given.append((voltages, self.problem.reference))
        return np.ones((len(voltages), *self.problem.mask.shape))


def test_sessions_are_reconstructed_one_by_one_with_their_reference_frames(data: Dataset) -> None:
    watcher, problem = Watcher(), Problem(data.sensor, data.references[-1], no_split)
    watcher.fit(problem)
    assert reconstructed(watcher, problem, data).shape == (7, 12, 12)
    assert [len(frames) for frames, _ in watcher.given] == [3, 3, 1]
    for (frames, reference), first in zip(watcher.given, (0, 3, 6), strict=True):
        np.testing.assert_array_equal(frames, data.voltages[first : first + TOUCHES])
        np.testing.assert_array_equal(reference, data.references[first])


def test_images_are_those_of_a_fit_to_each_session(data: Dataset) -> None:
    problem = Problem(data.sensor, data.references[0], no_split)
    method = create("noser")
    method.fit(problem)
    found = reconstructed(method, problem, data)
    for k, frame in enumerate(data.voltages):
        alone = create("noser")
        alone.fit(Problem(data.sensor, data.references[k], no_split))
        np.testing.assert_allclose(found[k], alone.reconstruct(frame[None])[0], atol=1e-9)
