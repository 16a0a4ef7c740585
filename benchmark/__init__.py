"""Evaluation: metrics, runs, their directory, tuning, checks and analyses."""

from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError, unknown_name
from eitbench.scenarios.storage.atomic_write import atomic_write

__all__ = ["DataCorruptError", "EitbenchError", "InputError", "atomic_write", "unknown_name"]
