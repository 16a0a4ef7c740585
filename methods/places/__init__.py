"""Regression of the place of a single contact, without an image."""

from eitbench.methods.places.kernel_ridge import kernel_ridge

__all__ = ["kernel_ridge"]
