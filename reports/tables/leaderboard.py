"""Leaderboards: the ranked rows of run directories, and the files that hold them."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from eitbench.benchmark import atomic_write
from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.standings import standings
from eitbench.reports.tables.formats import csv_text, to_html, to_latex, to_markdown


def ranked_rows(runs: Sequence[Path]) -> list[Row]:
    """Return the ranked rows of run directories, those of a scenario together.

    They are plain values for JSON; see `Standing.rows`. `why_not` says why there are no ties.

    Raises:
        InputError: a path is no run directory.
        DataCorruptError: a file of a run is damaged.
    """
    return [
        row | {"why_not": standing.why_not}
        for standing in standings([read_run(path) for path in runs])
        for row in standing.rows
    ]


def write_leaderboard(
    rows: Sequence[Row],
    folder: Path,
    forms: Sequence[str] = ("json", "csv", "md"),
    stem: str = "leaderboard",
) -> list[Path]:
    """Write `leaderboard.json`, `.csv` and `.md`, or other `FORMATS`, into `folder`."""
    written = []
    for form in forms:
        path = folder / f"{stem}.{'tex' if form == 'latex' else form}"
        atomic_write(path, FORMATS[form](rows).encode())
        written.append(path)
    return written


def to_json(rows: Sequence[Row]) -> str:
    """A list of rows, in full precision."""
    return json.dumps(list(rows), indent=2, allow_nan=False) + "\n"


def to_csv(rows: Sequence[Row]) -> str:
    """One line per row, in full precision; empty where a figure is not defined."""
    return csv_text(pd.DataFrame(rows, dtype=object)) if len(rows) else ""


FORMATS: dict[str, Callable[[Sequence[Row]], str]] = {
    "md": to_markdown,
    "csv": to_csv,
    "json": to_json,
    "latex": to_latex,
    "html": to_html,
}
