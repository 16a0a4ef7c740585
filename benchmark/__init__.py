"""How it is judged: metrics, runner, result store, timing and method checks."""

from eitbench.scenarios.errors import EitbenchError, InputError

__all__ = ["EitbenchError", "InputError"]
