"""Where records lie, what they say of the runs that they are from, and how a table is printed."""

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.reports.board.changes import version_key
from eitbench.reports.tables.formats import markdown_table
from eitbench.reports.tables.leaderboard import ranked_rows

DOCS = Path(__file__).resolve().parents[1]
STUDIES = DOCS / "studies"
SCENARIOS = {
    "noise-clean": "clean",
    "noise-60db": "60 dB",
    "noise-50db": "50 dB",
    "noise-40db": "40 dB",
    "noise-30db": "30 dB",
    "shapes": "unseen shapes, 50 dB",
}
"""Titles of the scenarios of `noise` and `shapes`."""


BOARD = DOCS.parent / "reports" / "board"


def recorded(suite: str) -> list[Row]:
    """Rows of the leaderboards of a suite in its newest record."""
    return ranked_rows([newest(suite)])


@cache
def record(suite: str) -> Run:
    """Return the newest record of a suite."""
    return read_run(newest(suite))


def newest_version() -> Path:
    """Return the folder of the newest version of the leaderboard."""
    return max(BOARD.glob("2*"), key=lambda path: version_key(path.name))


def newest(suite: str) -> Path:
    """Return the folder of the newest record of a suite."""
    records = BOARD.glob(f"2*/{suite}/manifest.json")
    return max(records, key=lambda path: version_key(path.parents[1].name)).parent


def printed(
    heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool] | None = None
) -> str:
    """Return a table in Markdown."""
    return "\n".join(markdown_table(heads, rows, right))


def _command(line: str) -> str:
    """The command as a user writes it, without folder and processes, also if `python -c` ran it."""
    return re.sub(r" --(out|jobs) ('[^']*'|\S)+", "", re.sub(r"^-c ", "eitbench ", line))


def about_runs(runs: Sequence[Run]) -> list[dict[str, object]]:
    """Return command, version and data of stored runs, for a record."""
    return [
        {
            "command": _command(run.manifest["command_line"]),
            **{name: run.manifest[name] for name in ("git_commit", "versions")},
            "data": {name: data["hash"] for name, data in run.manifest["data"].items()},
        }
        for run in runs
    ]
