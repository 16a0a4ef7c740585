"""Reconstruction by untrained networks (deep image prior)."""
