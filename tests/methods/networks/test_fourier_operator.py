"""Spectral convolutions against convolutions that are added up, and the operator made of them."""

import numpy as np
import pytest
import torch

from eitbench.methods.networks.fourier_operator import FourierLayers, SpectralConvolution


@pytest.mark.parametrize("grid", [(6, 8), (5, 7), (20, 22)])
def test_a_layer_is_the_circular_convolution_with_the_kernel_of_its_modes(
    grid: tuple[int, int],
) -> None:
    torch.manual_seed(0)
    layer = SpectralConvolution(2, grid)
    rows, columns = layer.modes
    matrices = torch.view_as_complex(layer.matrices.detach()).numpy()
    spectrum = np.zeros((grid[0], grid[1] // 2 + 1, 2, 2), dtype=complex)
    for row in range(2 * rows):
        frequency = row if row < rows else row - 2 * rows
        spectrum[frequency, :columns] = matrices[row]
    kernel = np.fft.irfft2(spectrum, s=grid, axes=(0, 1))  # (h, w, from, to)
    maps = torch.randn(1, *grid, 2)
    expected = np.zeros((*grid, 2))
    for y in range(grid[0]):
        for x in range(grid[1]):
            shifted = np.roll(kernel, (y, x), axis=(0, 1))
            expected += maps[0, y, x].numpy() @ shifted
    np.testing.assert_allclose(layer(maps)[0].detach().numpy(), expected, atol=1e-5)


def test_a_layer_moves_with_its_maps() -> None:
    torch.manual_seed(0)
    layer = SpectralConvolution(3, (12, 9))
    maps = torch.randn(2, 12, 9, 3)
    moved = layer(maps.roll((5, -2), (1, 2)))
    torch.testing.assert_close(moved, layer(maps).roll((5, -2), (1, 2)), atol=1e-5, rtol=1e-4)


def test_a_layer_drops_what_is_finer_than_its_modes() -> None:
    layer = SpectralConvolution(1, (32, 32))
    wave = torch.cos(2 * torch.pi * 9 * torch.arange(32) / 32)
    for maps in (wave[:, None].expand(32, 32), wave[None].expand(32, 32)):
        assert layer(maps[None, :, :, None]).abs().max() < 1e-5
    coarser = torch.cos(2 * torch.pi * 7 * torch.arange(32) / 32).expand(32, 32)
    assert layer(coarser[None, :, :, None]).abs().max() > 1e-2


def test_a_layer_is_as_exact_under_autocast() -> None:
    torch.manual_seed(0)
    layer = SpectralConvolution(3, (12, 12))
    maps = torch.randn(2, 12, 12, 3)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        found = layer(maps)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, layer(maps))


def test_every_pixel_reaches_every_other_in_one_pass() -> None:
    torch.manual_seed(0)
    layers = FourierLayers((18, 21), 4)
    torch.nn.init.normal_(layers.leave.weight)
    images = torch.zeros(1, 18, 21, requires_grad=True)
    layers(images)[0, 0, 0].backward()
    assert images.grad is not None
    assert (images.grad != 0).float().mean() > 0.99
