"""Samples to learn from are a torch data set, writable, and never those of the test split."""

import numpy as np
import pytest
from torch.utils.data import DataLoader

from eitbench.methods.problem import Problem
from eitbench.methods.training.torch_data import training_data
from eitbench.scenarios.data.datasets import load
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


def test_the_test_split_is_not_for_learning() -> None:
    with pytest.raises(InputError, match="Learn from the split 'train' or 'validation'"):
        training_data(SMALL, split="test")
    with pytest.raises(InputError, match="Unknown scenario 'quik'"):
        training_data("quik")
