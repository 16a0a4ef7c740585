"""Runs of a suite, from a plan to a finished run directory."""
