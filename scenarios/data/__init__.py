"""Data sets of a scenario: simulated, cached, loaded."""
