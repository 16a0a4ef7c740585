"""A problem whose reference frame is measured anew: gain, differences, and images of sessions."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.support.small_sensors import clean_problem, foam, touch

from eitbench.methods import Method, Problem, create
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.imperfections.training_units import TrainingImperfections
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


def test_what_a_dead_electrode_spoils_of_the_reference_frame_is_the_models() -> None:
    """So that methods that divide by the reference frame do not divide by next to nothing."""
    s = foam()
    problem, board = clean_problem(s), Imperfections(dead=(3,), offset=0.001)
    frame = problem.background_voltages
    problem.reference = 250 * board.analogue(frame[None], frame, s.pattern)[0]
    spoiled = (s.pattern.table == 3).any(axis=1)
    assert np.abs(problem.reference[spoiled]).max() < 0.01 * np.abs(problem.reference).max()
    np.testing.assert_array_equal(problem.unit_reference[spoiled], frame[spoiled])
    sound = problem.reference[~spoiled] / problem.gain
    np.testing.assert_array_equal(problem.unit_reference[~spoiled], sound)


def test_a_board_of_which_little_is_connected_is_not_said_to_have_another_order() -> None:
    """Of values that answer all are unlike the sensor's, which says nothing of their signs."""
    s = sensor("ohmc16")
    answers = np.isin(s.pattern.table[:, :2], [0, 1, 8, 9]).all(axis=1)
    problem = clean_problem(s)
    problem.reference = problem.background_voltages * answers
    said = f"{np.sum(~answers)} of {s.n_measurements} are zero"
    with pytest.raises(InputError, match=said):
        problem.difference(problem.reference[None])


@pytest.mark.parametrize("power", [-1.0, np.nan, np.inf])
def test_powers_of_gains_are_at_least_0(power: float) -> None:
    problem = clean_problem(foam())
    problem.reference = problem.background_voltages * 1.1
    for found in (problem.difference, problem.as_estimated):
        with pytest.raises(InputError, match="power of gains is at least 0"):
            found(problem.background_voltages[None], power)


def test_a_buffer_that_is_filled_anew_gives_another_reference_frame() -> None:
    problem = clean_problem(foam())
    buffer = 2 * problem.background_voltages
    problem.reference = buffer
    assert problem.gain == pytest.approx(2)
    buffer *= 3
    problem.reference = buffer
    assert problem.gain == pytest.approx(6)


def test_a_later_reference_frame_is_held_to_the_same_rules() -> None:
    problem = clean_problem(foam())
    with pytest.raises(InputError, match=r"The reference frame cannot be used.*need shape"):
        problem.reference = problem.reference[:-1]
    with pytest.raises(InputError, match=r"The reference frame cannot be used.*not a finite"):
        problem.reference = np.nan * problem.reference
    with pytest.raises(InputError, match="Frames are complex"):
        problem.difference((problem.reference + 1j)[None])
    problem.reference = -problem.reference
    with pytest.raises(InputError, match="does not match the sensor's drive pattern"):
        problem.difference(problem.reference[None])


def test_a_silent_board_is_said_to_be_one() -> None:
    problem = clean_problem(foam())
    problem.reference = 0 * problem.reference
    with pytest.raises(InputError, match="zero everywhere: is the board connected"):
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


UNEVEN = NOISY.model_copy(
    update={
        "name": "uneven",
        "train": 24,
        "noise": SplitNoise(train=50),
        "training_imperfections": TrainingImperfections(
            electrode_shift_m=0.0005, drift=0.01, gain=0.05, dead_share=0.5
        ),
    }
)


@pytest.mark.parametrize("gain_power", [0.0, 1.0])
def test_what_is_learned_from_is_what_is_seen_in_use(gain_power: float) -> None:
    """To the last bit, for the frames of a session; dead electrodes are filled in alike."""
    learned = load(UNEVEN, "train")
    problem = Problem(learned.sensor, learned.references[0], no_split)
    found = problem.differences(learned, gain_power)
    told: list[float] = []
    for first in range(0, len(learned), TOUCHES):
        rows = slice(first, first + TOUCHES)
        problem.reference = learned.references[first]
        in_use = problem.difference(learned.voltages[rows], gain_power)
        np.testing.assert_array_equal(found[rows], in_use)
        one = problem.difference(learned.voltages[first : first + 1], gain_power)
        np.testing.assert_allclose(found[first], one[0], atol=1e-12)
        dead = UNEVEN.split_imperfections("train", first // TOUCHES).dead
        if dead and gain_power == 0:
            spoiled = np.isin(learned.sensor.pattern.table, dead).any(axis=1)
            change = learned.voltages[rows] - learned.references[rows]
            np.testing.assert_allclose(in_use[:, ~spoiled], (change / problem.gain)[:, ~spoiled])
            # The others tell most of what a touch changes there.
            assert learned.conductivity is not None
            truth = forward_model(learned.sensor)
            for k, row in enumerate(in_use[:, spoiled]):
                image = np.where(
                    learned.sensor.mask, learned.conductivity[first + k], learned.sensor.background
                )
                expected = (truth.voltages(image) - problem.background_voltages)[spoiled]
                told.append(float(np.corrcoef(row, expected)[0, 1]))
    assert gain_power or (len(told) >= 6 and np.median(told) > 0.8)


@pytest.mark.parametrize("gain_power", [0.0, 1.0])
def test_noise_goes_through_what_differences_go_through(gain_power: float) -> None:
    learned = load(UNEVEN, "train")
    problem = Problem(learned.sensor, learned.references[0], no_split)
    which, matrices = problem.estimates(learned.references, gain_power)
    np.testing.assert_array_equal(matrices[0], np.eye(208))
    noise = np.random.default_rng(0).normal(scale=1e-3, size=learned.voltages.shape)
    louder = replace(learned, voltages=learned.voltages + noise)
    gains = np.array([problem_gain(problem, reference) for reference in learned.references])
    expected = problem.differences(louder, gain_power) - problem.differences(learned, gain_power)
    seen = np.einsum("nij,nj->ni", matrices[which], noise / gains[:, None])
    np.testing.assert_allclose(seen, expected, atol=1e-8)
    if gain_power == 0:  # only faults are filled in, alike for units with the same ones
        dead = [UNEVEN.split_imperfections("train", k).dead for k in range(len(learned) // TOUCHES)]
        assert [bool(k) for k in which[::TOUCHES]] == [bool(one) for one in dead]
        assert len(matrices) == 1 + len({frozenset(one) for one in dead if one})


def problem_gain(problem: Problem, reference: Array) -> float:
    problem.reference = reference
    return problem.gain


def test_differences_of_the_nominal_sensor_lose_what_gains_that_are_taken_out_lose() -> None:
    """As if the nominal sensor's change were measured by the board of the reference frame."""
    s = foam()
    problem, model = clean_problem(s), forward_model(s)
    change = (model.voltages(touch(s)) - problem.background_voltages)[None]
    np.testing.assert_array_equal(problem.as_estimated(change, 1.0), change)
    gains = np.exp(np.random.default_rng(0).normal(scale=0.5, size=208))
    problem.reference = 3 * gains * problem.background_voltages
    board = problem.reference + 3 * gains * change
    of_median = problem.difference(board, 1.0)
    found = problem.as_estimated(change, 1.0)
    ratio = float(np.vdot(found, of_median) / np.vdot(found, found))
    # Gains of the weakest measurements are cut.
    assert np.linalg.norm(of_median - ratio * found) < 0.01 * np.linalg.norm(of_median)
    assert 0.5 < np.linalg.norm(found) / np.linalg.norm(change) < 1
    np.testing.assert_array_equal(problem.as_estimated(change, 0.0), change)
