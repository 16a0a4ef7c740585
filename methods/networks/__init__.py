"""Networks from voltages to images: backbones, decoders and refiners."""
