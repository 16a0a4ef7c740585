"""Evaluation: metrics, runs, their directory, tuning, checks and analyses."""

from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError

__all__ = ["DataCorruptError", "EitbenchError", "InputError"]
