"""Reconstruction with parameters learned from simulated data."""

from eitbench.methods.learned.image_networks import Dnn, TrainedMethod

__all__ = ["Dnn", "TrainedMethod"]
