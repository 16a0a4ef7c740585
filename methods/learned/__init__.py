"""Reconstruction with parameters learned from simulated data."""
