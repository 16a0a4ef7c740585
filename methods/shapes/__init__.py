"""Reconstruction of shapes: an image that a few parameters describe, with their posterior."""
