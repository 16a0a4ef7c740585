"""Leaderboards: the ranked rows of run directories, and the files that hold them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import pandas as pd

from eitbench.benchmark import atomic_write, unknown_name
from eitbench.benchmark.analysis.leaderboard import Row, boards
from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.analysis.standings import standings
from eitbench.reports.tables.columns import Column, Layout, layout, shown_columns
from eitbench.reports.tables.formats import csv_text, to_html, to_latex, to_markdown
from eitbench.reports.tables.gaps import tier_texts
from eitbench.reports.tables.references import data_keys


def ranked_rows(runs: Sequence[Path], columns: Sequence[str] = ()) -> list[Row]:
    """Return the ranked rows of run directories, those of a scenario together.

    They are plain values for JSON; see `Standing.rows`. `why_not` says why there are no ties,
    `cites` holds the keys of suite and recording in the bibliography, with commas, `tier` the
    tier of a record or submission in words, and `gap` the hidden figure minus the open one, with
    its interval; "" of other runs.

    Args:
        runs: the directories.
        columns: names that are looked up before the statistics, which take minutes.

    Raises:
        InputError: a path is no run directory, or there is no such column.
        DataCorruptError: a file of a run is damaged.
    """
    read = [read_run(path) for path in runs]
    if columns:
        of = layout({read[0].kind.name: ""})
        _named(of, of.columns, columns)
    about = {run.path.name: run.manifest for run in read}
    by_name = {run.path.name: run for run in read}
    return [
        row
        | {"why_not": standing.why_not, "cites": data_keys(about[row["run"]], row["scenario"])}
        | dict(zip(("tier", "gap"), tier_texts(by_name[row["run"]], row), strict=True))
        for standing in standings(read)
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


def sorted_rows(rows: Sequence[Row], by: str) -> list[Row]:
    """Return the rows of each scenario by the column `by`, the best first, then those without it.

    Of a figure of which a certain value is the best, the least come first.

    Raises:
        InputError: no row has such a column.
    """
    (by,) = columns_called(rows, [by])

    def order(row: Row) -> tuple[bool, Any]:
        column = layout(row).column(by)
        value = row.get(by)
        if value is None or value == "":
            return True, 0
        return False, -value if column and column.best == "max" else value

    return [row for board in boards(rows) for row in sorted(board, key=order)]


def chosen_columns(rows: Sequence[Row], names: Sequence[str]) -> list[str]:
    """Return the columns `names`, after that of the method or operator, which is always shown.

    Raises:
        InputError: no row has such a column.
    """
    names = columns_called(rows, names)
    own = "operator" if rows and "operator" in rows[0] else "method"
    return list(dict.fromkeys([own, *names] if own not in names else names))


def columns_called(rows: Sequence[Row], names: Sequence[str]) -> list[str]:
    """Return the columns that have these names, titles or headings in a printed table of `rows`.

    Raises:
        InputError: there is none.
    """
    if not rows:
        return list(names)
    # Two columns may share the first line of a heading, of which a board shows one.
    shown = [column for board in boards(rows) for column in shown_columns(board)]
    of = layout(rows[0])
    return _named(of, [*shown, *of.columns], names)


def _named(of: Layout, columns: Sequence[Column], names: Sequence[str]) -> list[str]:
    """Return the `columns` that have these names, titles or headings; the first of several."""
    called: dict[str, str] = {column.name: column.name for column in columns}
    for column in columns:
        heading = of.terminal.get(column.name, column.title)
        for text in (column.title, heading.replace("\n", " "), heading.split("\n")[0]):
            called.setdefault(text.casefold(), column.name)
    for name in names:
        if name.casefold() not in called:
            raise unknown_name("column", name, [column.name for column in of.columns])
    return [called[name.casefold()] for name in names]


def to_json(rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
    """A list of rows, in full precision."""
    return json.dumps(_only(rows, columns), indent=2, allow_nan=False) + "\n"


def to_csv(rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
    """One line per row, in full precision; empty where a figure is not defined."""
    return csv_text(pd.DataFrame(_only(rows, columns), dtype=object)) if len(rows) else ""


def _only(rows: Sequence[Row], columns: Sequence[str]) -> list[Row]:
    """Return rows with these columns, if any, and their suite and scenario."""
    if not columns:
        return list(rows)
    return [{name: row.get(name) for name in ("suite", "scenario", *columns)} for row in rows]


class Format(Protocol):
    """Writes rows as text, with some `columns` alone if any are given."""

    def __call__(self, rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
        """Return the text."""


FORMATS: dict[str, Format] = {
    "md": to_markdown,
    "csv": to_csv,
    "json": to_json,
    "latex": to_latex,
    "html": to_html,
}
