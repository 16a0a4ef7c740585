"""Hyper-parameters selected on the validation split, with one budget for all methods."""
