"""Runs of a suite, from a plan to a finished run directory."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.run.runner import resume_run, start_run

__all__ = ["resume_run", "start_run"]

# A run loads pandas, which its progress does not need.
__getattr__, __dir__ = lazy_names(__name__, {"resume_run": "runner", "start_run": "runner"})
