"""Scenarios and suites: declared parameters of what is simulated or read."""
