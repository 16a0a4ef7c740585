"""The published networks as they are here, layer by layer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch

from eitbench.methods.networks.image_network import ImageNetwork
from eitbench.methods.networks.layers import Layer, layers
from eitbench.methods.operators.surrogate import SurrogateNetwork
from eitbench.scenarios.sensors.sensor import foam16

__all__ = ["Layer", "published_networks"]


def published_networks() -> Mapping[str, Sequence[Layer]]:
    """Return the layers of the network of DNN and PhyDNN, and of the learned forward operator."""
    sensor = foam16()
    return {
        "phydnn": layers(ImageNetwork(sensor, "unet"), torch.zeros(2, sensor.n_measurements)),
        "surrogate": layers(SurrogateNetwork(sensor), torch.ones(2, *sensor.image_shape)),
    }
