"""Runs of a suite, from a plan to a finished run directory."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.run.progress import RunProgress
    from eitbench.benchmark.run.runner import RunInterruptedError, RunResult, resume_run, start_run

__all__ = ["RunInterruptedError", "RunProgress", "RunResult", "resume_run", "start_run"]

# A run loads pandas, which its progress does not need.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "RunInterruptedError": "runner",
        "RunProgress": "progress",
        "RunResult": "runner",
        "resume_run": "runner",
        "start_run": "runner",
    },
)
