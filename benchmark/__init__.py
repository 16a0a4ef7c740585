"""How it is judged: metrics, runner, result store, timing and method checks."""

from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError

__all__ = ["DataCorruptError", "EitbenchError", "InputError"]
