"""Boards without hardware: an emulated sensor, a replayed recording."""
