"""Trained weights: the packaged files, and how weight files are read and written."""

from eitbench.methods.weights.weight_files import WeightFiles, Weights, sensor_key

__all__ = ["WeightFiles", "Weights", "sensor_key"]
