"""Networks from voltages to images, the linear map they begin as, and what trains them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.support.small_sensors import foam, round_board
from torch import nn

from eitbench.methods import operator
from eitbench.methods.learned.image_network_training import PhysicalLoss
from eitbench.methods.learned.linear_maps import ridge
from eitbench.methods.networks.image_network import BACKBONES, ImageNetwork
from eitbench.methods.training.augmentation import UNTOUCHED, Augmentation, Symmetry, symmetries
from eitbench.methods.training.loop import channels_last
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.imperfections.noise import Noise
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.sensor import Sensor


def moved(network: nn.Module, spread: float = 0.1) -> None:
    torch.manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(spread * torch.randn_like(parameter))


@pytest.mark.parametrize("make", [foam, round_board, lambda: foam((37, 50))])
@pytest.mark.parametrize("backbone", BACKBONES)
def test_a_network_begins_as_a_linear_map_for_any_sensor(
    backbone: str, make: Callable[[], Sensor]
) -> None:
    s = make()
    network = ImageNetwork(s, backbone)
    n_inputs = network.averaging.shape[1]
    height, width = s.image_shape
    matrix = torch.randn(n_inputs, height * width)
    network.std.uniform_(1.0, 2.0)
    network.backbone.start_from(matrix)
    difference = torch.randn(5, s.n_measurements)
    with torch.autocast("cpu", dtype=torch.bfloat16):  # the linear part stays exact
        image = network(difference)
    linear = (difference @ network.averaging / network.std @ matrix).view(5, height, width)
    expected = torch.where(torch.from_numpy(s.mask), 1 + linear, 1.0)
    assert image.dtype == torch.float32
    torch.testing.assert_close(image, expected)


@pytest.mark.parametrize("backbone", BACKBONES)
def test_every_weight_of_a_network_is_used(backbone: str) -> None:
    network = ImageNetwork(foam((18, 21)), backbone)
    moved(network)
    network(torch.randn(3, 208)).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().max() > 0, name


@pytest.mark.parametrize("backbone", BACKBONES)
def test_frames_do_not_influence_one_another(backbone: str) -> None:
    network = ImageNetwork(foam(), backbone)
    moved(network, 0.02)
    frames = torch.randn(6, 208)
    alone = torch.cat([network(frame[None]) for frame in frames])
    torch.testing.assert_close(network(frames), alone, rtol=1e-4, atol=1e-4)


def test_a_paper_sized_network_fits_into_ten_megabytes() -> None:
    tensors = ImageNetwork(sensor("foam16"), "unet").state_dict().values()
    assert sum(tensor.nbytes for tensor in tensors) < 9.9e6


def test_ridge_is_least_squares_with_a_penalty_that_validation_chooses() -> None:
    rng = np.random.default_rng(0)
    x, seen = rng.standard_normal((60, 4)), rng.standard_normal((500, 4))
    x[:, 3] = seen[:, 3] = 0.0  # a measurement that never changes
    truth = rng.standard_normal((4, 3))
    y = (x @ truth + 1.5 * rng.standard_normal((60, 3))).astype(np.float32)
    target = (seen @ truth).astype(np.float32)
    found = ridge(x, y, seen, target)
    penalty = np.sqrt(found.weight * np.trace(x.T @ x) / 4) * np.eye(4)
    stacked = np.linalg.lstsq(np.vstack([x, penalty]), np.vstack([y, np.zeros((4, 3))]))[0]
    np.testing.assert_allclose(found.matrix, stacked, rtol=1e-3, atol=1e-5)
    error = np.mean((seen @ found.matrix - target) ** 2)
    assert found.validation_mse == pytest.approx(error, rel=1e-4)
    assert 1e-6 < found.weight < 0.3  # neither end of the choice
    assert ridge(x, (x @ truth).astype(np.float32), seen, target).weight == 1e-6


def symmetric(s: Sensor) -> list[Symmetry]:
    model = forward_model(s)
    return symmetries(s, torch.from_numpy(model.jacobian(model.background)))


def test_augmented_images_have_the_voltages_that_go_with_them() -> None:
    s = foam()
    model = forward_model(s)
    reference = torch.from_numpy(model.voltages(model.background))
    sigma = torch.from_numpy(np.random.default_rng(0).uniform(0.3, 1.0, (40, *s.image_shape)))
    difference = torch.from_numpy(model.voltages(sigma.numpy())) - reference
    augment = Augmentation("clean", symmetric(s), 1.0)
    torch.manual_seed(3)
    seen, untouched = set(), 0
    for _ in range(25):
        frames, images, motion = augment(difference, torch.ones(40).double(), sigma)
        seen.add((motion.turns, motion.mirrored))
        untouched += int((images == 1).all((1, 2)).sum())
        expected = model.voltages(images.numpy().copy()) - reference.numpy()
        np.testing.assert_allclose(frames, expected, atol=1e-9)
    assert len(seen) == 8
    assert untouched == pytest.approx(1000 * UNTOUCHED, abs=4 * np.sqrt(1000 * UNTOUCHED))


@pytest.mark.parametrize(
    ("noise", "share", "levels"), [("mixture", 0.5, (30, 60)), (40.0, 1.0, (40, 40))]
)
def test_noise_is_drawn_anew_as_the_scenario_declares(
    noise: Noise, share: float, levels: tuple[float, float]
) -> None:
    augment = Augmentation(noise, symmetric(foam())[:1], reference_rms=4.0)
    difference, rms = torch.zeros(4000, 208), torch.full((4000,), 3.0)
    torch.manual_seed(0)
    first, images, _ = augment(difference, rms, torch.ones(4000, 12, 12))
    second = augment(difference, rms, images)[0]
    assert not torch.equal(first, second)
    deviation = first.std(1)
    noisy = deviation[deviation > 0]
    assert len(noisy) / 4000 == pytest.approx(share, abs=0.03)
    # A frame of rms 3 and a reference frame of rms 4 are measured for a difference.
    snr = 20 * torch.log10(5.0 / noisy)
    # 208 values tell the level to half a decibel.
    assert float(snr.quantile(0.01)) == pytest.approx(levels[0], abs=1.5)
    assert float(snr.quantile(0.99)) == pytest.approx(levels[1], abs=1.5)
    assert float(snr.mean()) == pytest.approx(sum(levels) / 2, abs=0.5)


@pytest.mark.parametrize("name", ["jacobian", "fem"])
def test_the_physical_loss_is_the_published_one(name: str) -> None:
    s = replace(foam(), background=2.0)
    model, forward = forward_model(s), operator(name, s)
    rng = np.random.default_rng(0)
    truth = 2.0 * rng.uniform(0.3, 1.0, (3, *s.image_shape))
    reference, frames = model.voltages(model.background), model.voltages(truth)
    motions = symmetric(s)
    turned = [motion.voltages(torch.from_numpy(frames)) for motion in motions]
    std = torch.cat(turned).std(0).numpy()  # so that it is symmetric too
    loss = PhysicalLoss(forward, torch.from_numpy(reference), torch.from_numpy(std))
    difference = torch.from_numpy(frames - reference)
    # Beyond the range that a touch can cause, which is 0.05 to 1 times the background.
    relative = torch.from_numpy(rng.uniform(-0.2, 1.3, (3, *s.image_shape))).requires_grad_()
    found = loss(relative, difference, None)
    kept = 2.0 * np.clip(relative.detach().numpy(), 0.05, 1.0)
    expected = np.mean(((forward.voltages(kept) - frames) / std) ** 2)
    assert found.item() == pytest.approx(expected, rel=1e-9)
    (gradient,) = torch.autograd.grad(found, relative)
    outside = (relative < 0.05) | (relative > 1.0)
    assert (gradient[outside] == 0).all()
    assert (gradient[~outside] != 0).all()
    if name == "fem":
        assert loss(torch.from_numpy(truth / 2.0), difference, None).item() < 1e-20
    for motion in motions:
        turned_loss = loss(motion.images(relative), motion.voltages(difference), motion)
        assert turned_loss.item() == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("backbone", BACKBONES)
def test_kernels_are_laid_out_for_a_gpu_without_a_change_of_the_image(backbone: str) -> None:
    """Weights of a spectral layer have five dimensions, which cannot be laid out so."""
    network = ImageNetwork(foam((16, 16)), backbone)
    moved(network, 0.02)
    frames = torch.randn(3, 208, generator=torch.Generator().manual_seed(0))
    before = network(frames)
    channels_last(network)
    kernels = [p for p in network.parameters() if p.dim() == 4]
    assert all(p.is_contiguous(memory_format=torch.channels_last) for p in kernels)
    torch.testing.assert_close(network(frames), before, rtol=1e-4, atol=1e-4)
