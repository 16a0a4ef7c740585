"""Analyses of stored runs: leaderboards, standings, comparisons, submissions."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.benchmark.analysis.comparison import compare
    from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
    from eitbench.benchmark.analysis.results import Run, read_run

__all__ = ["Run", "compare", "leaderboard_rows", "read_run"]

# Tables and arrays are read by pandas, pyarrow and h5py, which not every importer needs.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Run": "results",
        "compare": "comparison",
        "leaderboard_rows": "leaderboard",
        "read_run": "results",
    },
)
