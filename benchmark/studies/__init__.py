"""Experiments of many runs or trainings: training studies, published claims, real presses."""
