"""Analyses of stored runs: leaderboards, standings, comparisons, submissions."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
    from eitbench.benchmark.analysis.results import Run, read_run

__all__ = ["Run", "leaderboard_rows", "read_run"]

# Tables and arrays are read by pandas, pyarrow and h5py, which not every importer needs.
__getattr__, __dir__ = lazy_names(
    __name__, {"leaderboard_rows": "leaderboard", "Run": "results", "read_run": "results"}
)
