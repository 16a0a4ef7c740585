"""The implicit neural representation: its features, and images fitted to voltages."""

import math

import numpy as np
import pytest
import torch
from tests.support.small_sensors import foam, touch

from eitbench.methods import Problem, create
from eitbench.methods.networks.coordinate_network import CoordinateNetwork
from eitbench.methods.problem import no_split
from eitbench.methods.untrained.inr import Inr
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model


def test_features_have_the_bandwidth_and_equal_length_everywhere() -> None:
    """The mean product of the features of two places is the kernel exp(-(pi b d)^2 / 2)."""
    torch.manual_seed(0)
    made = [CoordinateNetwork((1, 41), (1.0, 1.0), 0.7).features for _ in range(60)]
    features = torch.cat(made, dim=-1)[0].double().numpy()
    products = features @ features.T / (features.shape[1] / 2)
    assert np.diag(products) == pytest.approx(1)
    distance = 2 * np.arange(41) / 41  # coordinates run from -1 to 1
    expected = np.exp(-((math.pi * 0.7 * distance) ** 2) / 2)
    assert products[0] == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("shape", [(12, 24), (24, 12), (12, 12)])
def test_features_do_not_depend_on_how_many_pixels_a_sensor_has(shape: tuple[int, int]) -> None:
    """Points of a square sensor that are as far apart have the same kernel in x and in y."""
    torch.manual_seed(0)
    sizes = foam(shape).pixel_size
    made = [CoordinateNetwork(shape, sizes, 0.2).features for _ in range(60)]
    features = torch.cat(made, dim=-1).double()
    products = features @ features[0, 0] / (features.shape[-1] / 2)
    for along, count in ((products[:, 0], shape[0]), (products[0], shape[1])):
        distance = 2 * torch.arange(count) / count
        expected = torch.exp(-((math.pi * 0.2 * distance) ** 2) / 2)
        assert along.tolist() == pytest.approx(expected.tolist(), abs=0.06)


def test_an_image_begins_as_the_background_and_is_as_wide_as_the_sensor() -> None:
    network = CoordinateNetwork((6, 9), (1.0, 1.0), 1.0)
    assert network().shape == (6, 9)
    assert not network().any()


@pytest.mark.slow
def test_an_inclusion_is_recovered_better_than_in_one_linear_step() -> None:
    s = foam((16, 16))
    truth = touch(s)
    model = forward_model(s)
    problem = Problem(s, model.voltages(model.background), no_split)
    images = []
    for method in (create("noser", weight=1e-4), Inr(steps=200)):
        method.fit(problem)
        images.append(method.reconstruct(model.voltages(truth)[None])[0])
    linear, found = (np.sqrt(np.mean((image - truth) ** 2)) for image in images)
    assert found < 0.8 * linear


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        (Inr(bandwidth=0.0), "'inr' needs a positive bandwidth, got 0.0"),
        (Inr(steps=0), "'inr' needs at least 1 step"),
        (Inr(steps=2.5), "a whole number of them"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_is_refused(method: Inr, sentence: str) -> None:
    s = foam((12, 12))
    model = forward_model(s)
    with pytest.raises(InputError, match=sentence):
        method.fit(Problem(s, model.voltages(model.background), no_split))
