"""Networks from voltages to images: backbones, decoders and refiners."""

from eitbench.methods.networks.decoder import Decoder
from eitbench.methods.networks.image_network import BACKBONES, ImageNetwork
from eitbench.methods.networks.refiner import Refiner

__all__ = ["BACKBONES", "Decoder", "ImageNetwork", "Refiner"]
