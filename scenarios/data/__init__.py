"""Data sets of a scenario: simulated, cached, loaded."""

from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.data.simulation import clean_voltages, phantom

__all__ = ["Dataset", "clean_voltages", "load", "phantom"]
