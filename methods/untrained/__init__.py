"""Reconstruction by networks that are fitted to each frame."""
