"""The board of the Kuopio Tomography Challenge 2023."""

import pandas as pd

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.reports.findings.finding import Finding
from eitbench.reports.tables.challenge import LEGEND, challenge_rows, challenge_table
from eitbench.reports.tables.columns import printable


def findings(run: Run) -> list[Finding]:
    """The scores summed over all targets beside published ones; none of other runs."""
    if run.kind != METHOD_RUNS or "ktc_score" not in run.samples:
        return []
    judged = run.samples["ktc_score"].notna().any()
    rows = challenge_rows(leaderboard_rows([run])) if judged else []
    if not rows:
        return []
    heads, *body = challenge_table(rows)
    grid = [[head.removeprefix("Level ") for head in heads]]
    grid += [[printable(text) for text in row] for row in body]
    table = pd.DataFrame(grid[1:], columns=grid[0])
    return [Finding("challenge", "KTC2023", table, grid, LEGEND)]
