"""Evaluation: metrics, runs, their directory, tuning, checks and analyses."""

from eitbench.scenarios.arrays import nearest_pixels
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError, unknown_name
from eitbench.scenarios.storage.atomic_write import atomic_write

__all__ = [
    "DataCorruptError",
    "EitbenchError",
    "InputError",
    "atomic_write",
    "nearest_pixels",
    "unknown_name",
]
