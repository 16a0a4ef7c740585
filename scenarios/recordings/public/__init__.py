"""Readers of the public recorded sets."""
