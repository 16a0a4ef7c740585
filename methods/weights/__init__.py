"""Trained weights: the packaged files, and how weight files are read and written."""
