"""Leaderboards for a terminal: the columns that fit its width, the best values green.

Below each stands which columns did not fit, and what those that are shown mean.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.reports.tables.boards import (
    PrintedBoard,
    note,
    printed_boards,
    prior_knowledge,
    tracks_table,
)
from eitbench.reports.tables.challenge import LEGEND, challenge_rows, challenge_table
from eitbench.reports.tables.columns import Column, layout, legend

if TYPE_CHECKING:
    from rich.console import Group

_LONGEST_NAME = 24
_PADDING = 3


def table(rows: Sequence[Row], width: int, columns: Sequence[str] = ()) -> "Group":
    """One table per scenario for a terminal of `width` characters, with its notes below it.

    Args:
        columns: names of those to show, however wide; by default what fits.
    """
    from rich import box
    from rich.console import Group, RenderableType
    from rich.table import Table
    from rich.text import Text

    parts: list[RenderableType] = []
    for board in printed_boards(rows, columns):
        fitting = board.columns() if columns else _fitting(board, width)
        headings = layout(board.rows[0]).terminal
        shown = Table(
            title=Text(board.title, style="bold"), title_justify="left", box=box.SIMPLE_HEAD
        )
        for column in fitting:
            shown.add_column(
                Text(headings.get(column.name, column.title)),
                justify="right" if column.form else "left",
                vertical="bottom",
                no_wrap=column.form != "",
                max_width=None if column.form else _LONGEST_NAME,
                overflow="fold",
            )
        for row in board.rows:
            shown.add_row(
                *(
                    Text(c.text(row), style="bold green" if board.is_best(c, row) else "")
                    for c in fitting
                )
            )
        parts += [shown, Text(f" {legend(fitting, headings)}")]
        if not columns and (text := _not_shown(board, fitting)):
            parts.append(Text(f" {text}"))
        if text := note(board.rows):
            parts.append(Text(f" {text}"))
        if tracks := tracks_table(board.rows):
            heads, *body = tracks
            beside = Table(title="Tracks", title_justify="left", box=box.SIMPLE_HEAD)
            for k, head in enumerate(heads):
                beside.add_column(Text(head), justify="right" if k else "left")
            for cells in body:
                beside.add_row(*map(Text, cells))
            parts.append(beside)
        parts += [Text(f" Prior knowledge: {text}") for text in prior_knowledge(board.rows)]
        parts.append(Text())
    if challenge := challenge_rows(rows):
        heads, *body = challenge_table(challenge)
        sums = Table(title="KTC2023", title_justify="left", box=box.SIMPLE_HEAD)
        for k, head in enumerate(heads):
            sums.add_column(Text(head.removeprefix("Level ")), justify="right" if k > 1 else "left")
        for cells in body:
            sums.add_row(*map(Text, cells))
        parts += [sums, Text(f" {LEGEND}")]
    return Group(*parts)


def _not_shown(board: PrintedBoard, shown: Sequence[Column]) -> str:
    """Return which columns of a board are not shown, and how to see them; "" without any."""
    headings = layout(board.rows[0]).terminal
    left = [column for column in board.columns() if column not in shown]
    narrow = [headings[c.name].split("\n")[0] for c in left if c.name in headings]
    others = [column.title for column in left if column.name not in headings]
    parts = []
    if narrow:
        parts.append(
            f"Hidden at this width: {', '.join(narrow)}; see them in a wider terminal, or name "
            "columns: `eitbench leaderboard RUN --columns rank,method,...`."
        )
    if others:
        parts.append(f"In files only: {', '.join(others)}.")
    if parts:
        parts.append("All columns: `eitbench leaderboard RUN --format md`.")
    return " ".join(parts)


def _fitting(board: PrintedBoard, width: int) -> list[Column]:
    """Return the most important columns that fit into `width` characters, in the usual order."""
    shown = {column.name: column for column in board.columns()}
    fitting, free = [], width - 1  # of which the right edge takes one
    for name, heading in layout(board.rows[0]).terminal.items():
        if name not in shown:
            continue
        texts = [*heading.split("\n"), *(shown[name].text(row) for row in board.rows)]
        longest = max(map(len, texts))
        free -= (longest if shown[name].form else min(longest, _LONGEST_NAME)) + _PADDING
        if free < 0:
            break
        fitting.append(name)
    return [column for name, column in shown.items() if name in fitting]
