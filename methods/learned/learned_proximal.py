"""Reconstruction by unrolled proximal steps, whose proximal maps are learned."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from eitbench.methods.learned.image_networks import ImageNetworkMethod
from eitbench.methods.registry import register
from eitbench.methods.training import Recipe
from eitbench.methods.weights.weight_files import WeightFiles

if TYPE_CHECKING:  # torch takes a second to import, and listing methods does not need it
    from eitbench.methods.networks.image_network import ImageNetwork
    from eitbench.scenarios.sensors.sensor import Sensor


@register("learned-proximal")
@dataclass
class LearnedProximal(ImageNetworkMethod):
    """Unrolled proximal gradient steps with learned proximal maps, from the best linear image."""

    source: ClassVar[str] = "Adler and Oktem, IEEE Trans. Med. Imaging 37(6), 2018"
    files: ClassVar = WeightFiles("learned-proximal")
    expected_failures: ClassVar = {
        "noise_growth": "the image of a clean frame differs from those of all noisy ones"
    }
    recipe: ClassVar = Recipe(epochs=14)
    options: ClassVar = ("limit", "unlimited", "start", "loss")
    backbone: ClassVar = "linear"

    @classmethod
    def network(cls, sensor: Sensor, backbone: str) -> ImageNetwork:
        """See `ImageNetworkMethod`; the backbone gives the first image."""
        from eitbench.methods.networks.unrolled import UnrolledNetwork

        return UnrolledNetwork(sensor, backbone)
