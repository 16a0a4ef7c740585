"""Regression of the place of a single contact, without an image."""
