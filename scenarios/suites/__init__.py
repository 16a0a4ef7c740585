"""Scenarios and suites: declared parameters of simulated and recorded data."""
