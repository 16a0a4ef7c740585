"""Reconstruction by untrained networks (deep image prior)."""

from eitbench.methods.untrained.dip import Dip

__all__ = ["Dip"]
