"""Recorded sensor sets: descriptors, readers and verified downloads."""
