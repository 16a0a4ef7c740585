"""Layers as they are read off a network."""

import pytest
import torch
from torch import Tensor, nn

from eitbench.methods.networks.image_network import Block, ImageNetwork
from eitbench.methods.networks.layers import Layer, layers
from eitbench.methods.operators.surrogate import SurrogateNetwork
from eitbench.scenarios import sensor


class Skips(nn.Module):
    """Two layers in a row and a skip past the second, scaled by a parameter of no layer."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(1, 4, 2, stride=2)
        self.second = Block(4)
        self.share = nn.Parameter(torch.ones(()))

    def forward(self, x: Tensor) -> Tensor:
        coarse = self.first(x[:, None])
        found: Tensor = (self.share * self.second(nn.functional.gelu(coarse)) + coarse).flatten(1)
        return found


@pytest.mark.slow
def test_layers_of_a_network_with_a_skip_as_written() -> None:
    assert layers(Skips(), torch.zeros(3, 6, 8)) == [
        Layer("input", "input", (6, 8), 0, ()),
        Layer("first", "conv 2 × 2 ↓2", (4, 3, 4), 4 * 4 + 4, ("input",)),
        Layer("second", "residual block", (4, 3, 4), 2 * (4 * 4 * 9 + 4), ("first",)),
        Layer("output", "output", (48,), 1, ("second", "first")),
    ]


@pytest.mark.slow
def test_the_published_networks_are_read_whole() -> None:
    of = sensor("foam16")
    for network, example in (
        (ImageNetwork(of, "unet"), torch.zeros(2, 208)),
        (SurrogateNetwork(of), torch.ones(2, 80, 80)),
    ):
        found = layers(network, example)
        names = [layer.name for layer in found]
        assert sum(layer.parameters for layer in found) == sum(
            parameter.numel() for parameter in network.parameters()
        )
        assert (names[0], names[-1]) == ("input", "output")
        for k, layer in enumerate(found):
            assert set(layer.inputs) <= set(names[:k])
        read = {name for layer in found for name in layer.inputs}
        assert read == set(names[:-1])  # nothing is computed in vain


def test_the_u_net_has_a_skip_on_every_grid_and_one_past_it() -> None:
    found = {
        layer.name: layer
        for layer in layers(ImageNetwork(sensor("foam16"), "unet"), torch.zeros(2, 208))
    }
    for level in (0, 1):
        merge = found[f"backbone.unet.merge.{level}"]
        assert set(merge.inputs) == {f"backbone.unet.{kind}.{level}" for kind in ("up", "encoder")}
    assert set(found["output"].inputs) == {"backbone.linear", "backbone.unet.leave"}
