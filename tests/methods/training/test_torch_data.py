"""Samples to learn from are a torch data set, writable, and never those of the test split."""

from dataclasses import replace

import numpy as np
import pytest
from torch.utils.data import DataLoader

from eitbench.methods import create
from eitbench.methods.learned.linear_maps import LinearTouch
from eitbench.methods.problem import Problem
from eitbench.methods.training.torch_data import training_data
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.scenario import SimulatedScenario

SMALL = SimulatedScenario(
    name="torch", image_shape=(16, 16), families=("circle",), train=6, validation=2, test=2
)


def test_pairs_of_a_difference_and_its_image_come_in_batches() -> None:
    found = training_data(SMALL, 5)
    assert len(found) == 5
    data = load(SMALL, split="train", limit=5)
    dv, sigma = found[1]
    np.testing.assert_allclose(dv, (data.voltages - data.references)[1], atol=1e-6)
    assert data.conductivity is not None
    np.testing.assert_array_equal(sigma, data.conductivity[1].astype(np.float32))
    (first, _), *_ = DataLoader(found, batch_size=4)
    first[0] = 0  # writable
    assert first.shape == (4, 208)


def test_a_method_learns_from_its_problem_which_notes_it() -> None:
    train = load(SMALL, split="train")
    problem = Problem(train.sensor, train.references[0], lambda of, n: load(SMALL, of, n))
    assert len(training_data(problem, split="validation")) == 2
    (noted,) = problem.access_record().samples
    assert (noted.split, noted.samples) == ("validation", 2)


@pytest.mark.parametrize("name", ["linear-learned", "linear-touch"])
def test_what_is_learned_does_not_depend_on_the_gain_of_another_sensor(name: str) -> None:
    """Training data have reference frames of their own, in V/A; the board has counts."""
    test, images = load(SMALL), []
    for gain in (1.0, 250.0):
        problem = Problem(test.sensor, gain * test.references[0], lambda of, n: load(SMALL, of, n))
        own = load(SMALL, split="train")
        dv, _ = training_data(problem).tensors
        np.testing.assert_allclose(dv, own.voltages - own.references, rtol=1e-3, atol=1e-6)
        method = create(name)
        method.fit(problem)
        images.append(method.reconstruct(gain * test.voltages))
    np.testing.assert_allclose(images[1], images[0], rtol=1e-9)
    assert np.ptp(images[0]) > 0.05


def test_a_validation_split_without_images_chooses_no_regularisation() -> None:
    """A part of the training split does, and the rest is learned from."""
    more = SMALL.model_copy(update={"name": "torch-presses", "train": 23})

    def splits(of: str, n: int | None) -> Dataset:
        data = load(more, of, n)
        return data if of == "train" else replace(data, truth="position")

    def learned(of: str, n: int | None) -> Dataset:
        """The same parts of the training split, as two splits."""
        data = load(more, "train")
        if of == "train":
            return data.first(20)
        return replace(
            data,
            voltages=data.voltages[20:],
            references=data.references[20:],
            phantoms=data.phantoms[20:],
            samples=data.samples[20:],
        )

    test, images = load(more), []
    for known in (splits, learned):
        method = create("linear-learned")
        method.fit(Problem(test.sensor, test.references[0], known))
        images.append(method.reconstruct(test.voltages))
    np.testing.assert_array_equal(images[0], images[1])
    assert np.ptp(images[0]) > 0.05


def test_linear_touch_shows_touches_of_its_training_as_strong_as_they_are() -> None:
    """The images that it makes of the frames it learned from have a slope of 1 to the true ones."""
    train = load(SMALL, split="train")
    problem = Problem(train.sensor, train.references[0], lambda of, n: load(SMALL, of, n))
    method = LinearTouch()
    method.fit(problem)
    assert train.conductivity is not None
    true = (train.conductivity / problem.background - 1)[:, problem.mask]
    shown = problem.differences(train) @ method._matrix
    assert np.vdot(shown, true) / np.vdot(shown, shown) == pytest.approx(1)


def test_the_test_split_is_not_for_learning() -> None:
    with pytest.raises(InputError, match="Learn from the split 'train' or 'validation'"):
        training_data(SMALL, split="test")
    with pytest.raises(InputError, match="Unknown scenario 'quik'"):
        training_data("quik")
