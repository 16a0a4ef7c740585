"""Evaluation: metrics, runs, their directory, tuning, checks and analyses."""

from eitbench.scenarios.atomic_write import atomic_write
from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError

__all__ = ["DataCorruptError", "EitbenchError", "InputError", "atomic_write"]
