"""Unrolled steps against one-step methods that are solved elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.support.small_sensors import clean_problem, foam, round_board, touch

from eitbench.methods import create
from eitbench.methods.networks.unrolled import ProximalStep, UnrolledNetwork
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor


def network() -> UnrolledNetwork:
    """On a sensor with a range so wide that nothing is cut."""
    s = replace(foam(), conductivity_range=(0.01, 100.0))
    return UnrolledNetwork(s, "linear")


def begun(unrolled: UnrolledNetwork) -> torch.Tensor:
    """Make the first image a random linear map, which is returned."""
    torch.manual_seed(0)
    linear = unrolled.backbone.linear
    matrix = 0.01 * torch.randn(linear.in_features, linear.out_features)
    unrolled.backbone.start_from(matrix)
    return matrix


@pytest.mark.parametrize("sensor", [foam(), round_board()])
def test_it_begins_as_the_image_of_its_backbone(sensor: Sensor) -> None:
    unrolled = UnrolledNetwork(sensor, "linear")
    matrix = begun(unrolled)
    difference = torch.randn(3, sensor.n_measurements)
    linear = (difference @ unrolled.averaging @ matrix).view(3, *sensor.image_shape)
    expected = torch.where(unrolled.mask, 1 + linear, 1.0)
    torch.testing.assert_close(unrolled(difference), expected)


@pytest.mark.parametrize("weight", [1e-3, 1e-1])
def test_a_step_from_the_untouched_sensor_is_nosers(weight: float) -> None:
    unrolled = network()
    s = unrolled.sensor
    problem = clean_problem(s)
    frame = forward_model(s).voltages(touch(s, factor=0.97))
    # NOSER has each measurement twice, by reciprocity; its weight is twice as large for that.
    noser = create("noser", weight=2 * weight)
    noser.fit(problem)
    expected = noser.reconstruct(frame[None])[0] - 1
    difference = torch.from_numpy(problem.difference(frame[None])).float()
    logs = torch.tensor([np.log(weight)]).float()
    found = unrolled.gradients(torch.zeros(1, *s.image_shape), difference, logs)[0, 0]
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(found.numpy(), expected, atol=2e-3 * np.abs(expected).max())


def test_an_image_that_explains_its_frame_has_no_gradient() -> None:
    unrolled = network()
    s = unrolled.sensor
    image = torch.from_numpy(touch(s) - 1).float()[None]
    factors = 2 * image / (2 + image)
    jacobian = torch.from_numpy(clean_problem(s).jacobian).flatten(1)
    explained = factors.flatten(1).double() @ jacobian.T
    logs = unrolled.steps[0].get_parameter("log_weights")
    left = unrolled.gradients(image, explained.float(), logs)
    elsewhere = unrolled.gradients(torch.zeros_like(image), explained.float(), logs)
    assert left.abs().max() < 1e-3 * elsewhere.abs().max()


def test_steps_along_the_gradient_explain_the_frame_better() -> None:
    unrolled = network()
    s = unrolled.sensor
    unrolled.backbone.start_from(torch.zeros_like(unrolled.backbone.linear.weight.T))
    problem = clean_problem(s)
    frames = forward_model(s).voltages(touch(s, factor=0.7))[None]
    difference = torch.from_numpy(problem.difference(frames)).float()

    def unexplained() -> float:
        image = unrolled(difference).detach().double().numpy()
        modelled = forward_model(s).voltages(image) - problem.background_voltages
        return float(np.linalg.norm(modelled - difference.numpy()))

    before = unexplained()
    for step in unrolled.steps:
        assert isinstance(step, ProximalStep)
        with torch.no_grad():
            step.lengths[0] = 1.0
    assert unexplained() < 0.1 * before


def test_every_weight_is_used() -> None:
    torch.manual_seed(0)
    unrolled = network()
    with torch.no_grad():
        for parameter in unrolled.parameters():
            parameter.add_(0.02 * torch.randn_like(parameter))
    unrolled(torch.randn(3, 208)).square().sum().backward()
    for name, parameter in unrolled.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name
