"""The U-Net of the Kuopio tank: its linear images, its sensors, and its images of real frames."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.support.small_sensors import TINY, suite_of

from eitbench.benchmark.metrics.ktc import ktc_score
from eitbench.methods.learned import tank_training
from eitbench.methods.learned.tank_training import Board, TankTask
from eitbench.methods.learned.tank_unet import (
    CHANNELS,
    NOISE,
    LinearImages,
    TankUNet,
    image_map,
)
from eitbench.methods.method import reconstructed
from eitbench.methods.networks.class_network import ClassNetwork
from eitbench.methods.problem import Problem, no_split
from eitbench.methods.training import TrainingRequest, train
from eitbench.scenarios.arrays import nearest_pixels
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.recordings.public.kuopio import tank
from eitbench.scenarios.sensors.sensor import foam16

Array = NDArray[np.float64]
COARSE = replace(tank(7), image_shape=(16, 16))


@cache
def linear() -> tuple[Array, Array, LinearImages]:
    """Jacobian (M, P), untouched frame (M,) and linear images of a coarse tank at level 7."""
    model = forward_model(COARSE)
    voltages, jacobian = model.linearise(model.background)
    inside = jacobian[:, COARSE.mask]
    return inside, voltages, LinearImages(inside, voltages, COARSE.mask)


def shown(images: LinearImages, difference: Array) -> Array:
    return np.asarray(np.einsum("m,mk,kcp->cp", difference, images.combinations, images.matrix))


def test_images_are_the_regularised_least_squares_solutions() -> None:
    """In the pixels: (J^T W J / w + C^-1)^-1 J^T W dv, without what is parallel to the frame."""
    jacobian, untouched, images = linear()
    weights = 1 / np.hypot(NOISE[0] * untouched, NOISE[1] * np.abs(untouched).max())
    unit = weights * untouched / np.linalg.norm(weights * untouched)
    rows = weights[:, None] * jacobian
    rows -= np.outer(unit, unit @ rows)
    covariance = np.sum(rows**2, axis=0) ** -0.5
    change = jacobian @ np.random.default_rng(0).normal(size=jacobian.shape[1])
    data = weights * change
    data -= unit * (unit @ data)
    weight = 0.03 * np.trace((rows * covariance) @ rows.T) / images.combinations.shape[1]
    normal = rows.T @ rows / weight + np.diag(1 / covariance)
    expected = np.linalg.solve(normal, rows.T @ data / weight)
    found = shown(images, change)[1]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


class Meta(torch.Tensor):
    """A batch on another device than random numbers are drawn on, such as a GPU."""

    def cpu(self) -> torch.Tensor:  # type: ignore[override]
        return torch.zeros(self.shape)


def test_a_batch_may_be_on_another_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tank_training, "working_precision", lambda _: nullcontext())
    _, untouched, images = linear()
    network = ClassNetwork(COARSE.mask, CHANNELS).to("meta")
    kept = torch.arange(len(untouched))
    level = (kept, image_map(images, COARSE.mask))
    task = TankTask(network, Board(COARSE.pattern, untouched), [level])
    difference = torch.empty(2, len(untouched), device="meta").as_subclass(Meta)
    loss = task.loss((difference, torch.empty(2, *COARSE.image_shape, device="meta")))
    assert loss.device.type == "meta"


def test_a_common_factor_of_all_values_is_no_object() -> None:
    jacobian, untouched, images = linear()
    change = 1e-2 * jacobian @ np.linspace(-1, 1, jacobian.shape[1])
    once, warmer = (shown(images, change + drift * untouched) for drift in (0.0, 0.1))
    assert np.abs(once).max() > 1e-3
    np.testing.assert_allclose(warmer, once, atol=1e-8)
    uneven = untouched * (1 + 0.1 * np.sin(np.arange(len(untouched))))
    left = images.differences(0.1 * uneven[None], uneven)
    np.testing.assert_allclose(left, 0, atol=1e-12)


def test_weights_serve_the_tank_without_some_electrodes_and_nothing_else() -> None:
    assert TankUNet.weights_hash(tank())
    assert {TankUNet.weights_hash(tank(level)) for level in range(1, 8)} == {
        TankUNet.weights_hash(tank())
    }
    assert not TankUNet.unusable(tank(3))
    assert TankUNet.unusable(foam16())
    assert TankUNet.unusable(COARSE)


def test_the_network_says_nothing_outside_the_tank() -> None:
    network = ClassNetwork(COARSE.mask, 2)
    torch.nn.init.normal_(network.unet.leave.weight)
    classes = network(torch.randn(3, 2, 16, 16)).detach().numpy()
    assert (classes[:, ~COARSE.mask] == 0).all()
    assert np.abs(classes).max() > 0


def test_the_board_changes_each_drive_alike() -> None:
    """Where there is but a gain, values of one drive and measuring pair keep their ratio."""
    torch.manual_seed(0)
    pattern = COARSE.pattern
    made = Board(pattern, np.zeros(len(pattern.table)))(1e6 * torch.ones(2, len(pattern.table)))
    drives = np.unique(pattern.table[:, :2], axis=0, return_inverse=True)[1]
    logs = np.log(made[0].numpy())
    of_first, of_second = (logs[drives == k] for k in (0, 1))
    np.testing.assert_allclose(np.diff(of_first), np.diff(of_second), atol=1e-5)
    assert 0.1 < float(made.mean()) / 1e6 < 3


@pytest.mark.usefixtures("recorded_data")
def test_true_classes_on_the_coarse_grid_lose_little() -> None:
    data = load("ktc2023-level7", "validation")
    assert data.classes is not None
    coarse = nearest_pixels(data.classes, data.sensor.image_shape)
    assert ktc_score(data.classes, coarse).min() > 0.97


def test_training_for_another_sensor_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    request = TrainingRequest("tank-unet", suite_of(tmp_path, TINY), epochs=1)
    with pytest.raises(
        InputError, match="'tank-unet' is for the tank of the Kuopio challenge, and"
    ):
        train(request)


@pytest.mark.slow
@pytest.mark.usefixtures("recorded_data")
def test_it_finds_the_training_targets() -> None:
    """At level 7, whose set-up is the shortest; an image without objects gets at most 0.5."""
    data = load("ktc2023-level7", "validation")
    method, problem = TankUNet(), Problem(data.sensor, data.references[0], no_split)
    method.fit(problem)
    images = reconstructed(method, problem, data)
    assert data.classes is not None
    assert ktc_score(data.classes, images - 1).mean() > 0.5
