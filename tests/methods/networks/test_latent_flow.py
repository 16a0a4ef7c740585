"""The flow over images: its density is that of its draws."""

import math

import pytest
import torch

from eitbench.methods.networks.latent_flow import COMPONENTS, MEASURED, LatentFlow

SHAPE = (12, 12)


@pytest.fixture
def flow() -> LatentFlow:
    """A flow that bends: its last layers are not zero, as they are at first."""
    with torch.random.fork_rng():
        torch.manual_seed(1)
        flow = LatentFlow(80, SHAPE)
        for name, tensor in flow.named_parameters():
            if name.endswith("leave.weight"):
                torch.nn.init.normal_(tensor, std=0.3)
        images, frames = torch.randn(400, *SHAPE), torch.randn(400, 80)
        flow.start_from(images, frames)
    return flow.requires_grad_(requires_grad=False)


def test_density_is_that_of_normal_numbers_over_the_volume(flow: LatentFlow) -> None:
    """By the Jacobian of the draws, from automatic differentiation."""
    generator = torch.Generator().manual_seed(2)
    normal = torch.randn(COMPONENTS, generator=generator)
    frame = torch.randn(1, 80, generator=generator)

    def components(numbers: torch.Tensor) -> torch.Tensor:
        return flow.encoded(flow.draws(numbers[None], frame)[:, 0])[0]

    volume = torch.linalg.slogdet(torch.func.jacrev(components)(normal))[1]
    expected = -normal.square().sum() / 2 - COMPONENTS / 2 * math.log(2 * math.pi) - volume
    found = flow.log_density(components(normal)[None], frame)[0]
    assert float(found) == pytest.approx(float(expected), abs=1e-2)
    assert abs(float(volume)) > 1  # it does bend


def test_a_sensor_of_few_measurements_and_pixels_has_fewer_components() -> None:
    flow = LatentFlow(40, (8, 8))
    flow.start_from(torch.randn(200, 8, 8), torch.randn(200, 40))
    assert (flow.components.shape, flow.seen.shape) == ((64, 64), (40, 40))
    assert flow.draws(torch.randn(3, 64), torch.randn(2, 40)).shape == (2, 3, 8, 8)
    assert flow.log_density(torch.randn(2, 64), torch.randn(2, 40)).shape == (2,)
    assert flow.draws(torch.randn(3, 64), torch.randn(0, 40)).shape == (0, 3, 8, 8)


def test_measurements_that_repeat_others_are_not_taken_for_information() -> None:
    """Of 40 measurements by 8 electrodes 20 repeat the others but for rounding."""
    torch.manual_seed(0)
    clean = torch.randn(200, 20) @ torch.randn(20, 40)
    flow = LatentFlow(40, (8, 8))
    flow.start_from(torch.randn(200, 8, 8), clean)
    seen = clean @ flow.seen
    assert float(seen.square().mean()) == pytest.approx(0.5, abs=0.1)  # half of them are 1
    noisy = clean + 1e-3 * clean.std() * torch.randn_like(clean)
    assert float((noisy @ flow.seen - seen).square().mean()) < 100


def test_components_are_those_of_principal_component_analysis(flow: LatentFlow) -> None:
    """Of as many as there are, beside NumPy's; images within their span come back."""
    generator = torch.Generator().manual_seed(3)
    images = torch.randn(300, *SHAPE, generator=generator) * torch.linspace(0.1, 1, 12)
    frames = torch.randn(300, 80, generator=generator)
    flow.start_from(images, frames)
    z = flow.encoded(images)
    torch.testing.assert_close(z.mean(0), torch.zeros(COMPONENTS), atol=1e-4, rtol=0)
    torch.testing.assert_close(z.square().mean(0), torch.ones(COMPONENTS), atol=0.02, rtol=0)
    within = flow.decoded(z)
    torch.testing.assert_close(flow.encoded(within), z, atol=1e-3, rtol=0)
    singular = torch.linalg.svdvals((images - images.mean(0)).flatten(1))
    kept = float((within - images.mean(0)).square().sum() / singular.square().sum())
    assert kept == pytest.approx(
        float(singular[:COMPONENTS].square().sum() / singular.square().sum()), rel=0.01
    )
    seen = frames @ flow.seen
    assert seen.shape == (300, MEASURED)
    torch.testing.assert_close(seen.square().mean(0), torch.ones(MEASURED), atol=0.02, rtol=0)


def test_draws_depend_on_the_frame_and_not_on_others(flow: LatentFlow) -> None:
    generator = torch.Generator().manual_seed(4)
    normal = torch.randn(3, COMPONENTS, generator=generator)
    frames = torch.randn(2, 80, generator=generator)
    together = flow.draws(normal, frames)
    assert together.shape == (2, 3, *SHAPE)
    torch.testing.assert_close(together[1:], flow.draws(normal, frames[1:]), atol=1e-5, rtol=0)
    assert (together[0] - together[1]).abs().max() > 0.01
