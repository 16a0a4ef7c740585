"""Phantoms: the families and their ranges, how one is drawn, how it becomes an image."""
