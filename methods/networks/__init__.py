"""Networks from voltages to images: what they share, and the backbones to choose from."""
