"""Boards as printed: rows of one suite, scenario and data, with their title and best values."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from eitbench.benchmark.analysis.leaderboard import Row, boards
from eitbench.reports.tables.columns import Column, layout, printable, shown_columns
from eitbench.reports.tables.published import published_rows

_HASH_DIGITS = 6


@dataclass(frozen=True)
class PrintedBoard:
    """Rows of the same suite, scenario and data.

    Attributes:
        title: of the table.
        rows: in their order; the published figures stand below those of the paper's scenarios.
    """

    title: str
    rows: list[Row]

    def columns(self) -> list[Column]:
        """The columns that say something here."""
        return shown_columns(self.rows)

    def is_best(self, column: Column, row: Row) -> bool:
        """True if the value of `row` is the best of its column, or printed like it."""
        # A mean over the easier part of the samples is no rival of one over all of them; methods
        # are charged for what they lose.
        whole = [r for r in self.rows if r["coverage"] == 1 or (r["coverage"] and "method" in r)]
        values: list[Any] = [r[column.name] for r in whole if r.get(column.name) is not None]
        if column.best is None or row not in whole or row[column.name] is None:
            return False
        # Values that print alike are highlighted alike, unless there is nothing to choose from.
        best = column.number(max(values) if column.best == "max" else min(values))
        return column.text(row) == best and any(column.number(v) != best for v in values)

    def paper_columns(self) -> list[Column]:
        """The columns that papers print."""
        names = layout(self.rows[0]).paper
        lost = any(row["coverage"] is not None and row["coverage"] < 1 for row in self.rows)
        return [c for c in self.columns() if c.name in names and (lost or c.name != "coverage")]


def printed_boards(rows: Sequence[Row]) -> list[PrintedBoard]:
    """Return the boards of `rows`, in the order given."""
    apart = boards(rows)
    names = [f"{board[0]['suite']} / {board[0]['scenario']}" for board in apart]
    return [
        PrintedBoard(
            printable(name if names.count(name) == 1 else f"{name} ({_data(board[0])})"),
            [*board, *published_rows(board)],
        )
        for name, board in zip(names, apart, strict=True)
    ]


def _data(row: Row) -> str:
    """Return the size and hash of data, which tell those of one scenario apart."""
    digits = "unknown" if row["data_hash"] is None else row["data_hash"][:_HASH_DIGITS]
    return f"n = {row['n'] if row['data_n'] is None else row['data_n']}, data {digits}"
