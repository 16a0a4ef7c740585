"""Deep image prior: an untrained convolutional network, fitted to a single frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from eitbench.methods.registry import register
from eitbench.methods.untrained.network_per_frame import NetworkPerFrame
from eitbench.scenarios.sensors.symmetry import asymmetry

if TYPE_CHECKING:
    from torch import nn


@register("dip")
@dataclass
class Dip(NetworkPerFrame):
    """An untrained network per frame, fitted to its voltages (deep image prior, DeepEIT).

    By default its `steps` are twice its window, so that it takes them all. For the attributes see
    `NetworkPerFrame`.
    """

    source: ClassVar[str] = "Liu et al., IEEE Trans. Pattern Anal. Mach. Intell. 45(8), 2023"
    expected_failures: ClassVar = asymmetry("its random network has no symmetry")
    name: ClassVar = "dip"
    learning_rate: ClassVar[float] = 0.013
    window: ClassVar[int] = 65

    steps: int = 130

    def network(self) -> nn.Module:
        """Return a decoder with a fixed random input."""
        from eitbench.methods.networks.decoder import Decoder

        return Decoder(self._problem.mask.shape)
