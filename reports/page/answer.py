"""One sentence about a board: its best method, how sure that is, and the fastest of its equals."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eitbench.benchmark.analysis.leaderboard import is_whole
from eitbench.benchmark.analysis.standings import SIGNIFICANT
from eitbench.reports.tables.columns import Column, layout, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.benchmark.analysis.leaderboard import Row
    from eitbench.reports.page.report_data import BoardData

_MOST_NAMES = 3


def answer(board: BoardData) -> str:
    """Return the best method of a board with its lead, or the methods that it is tied with."""
    rows, kind, by = board["views"][0]["rows"], board["kind"], board["ranked_by"]
    where = f"On {board['suite']} / {board['scenario']} ({board['n']:,} samples)"
    column = layout(rows[0]).column(by)
    first = rows[0]
    if column is None or first.get(by) is None:
        return printable(f"{where}, no {kind} has a figure to rank by.")
    if not is_whole(first):
        return printable(f"{where}, no {kind} has all samples yet.")
    figure = f"{column.title} {column.number(first[by])}"
    low, high = first.get(f"{by}_low"), first.get(f"{by}_high")
    if low is None or high is None:
        return printable(f"{where}, {first['label']} is first: {figure}.")
    figure += f" (95 %: {column.number(low)} to {column.number(high)})"
    pairs = [pair for pair in board["pairs"] if pair["first"] == 0]
    tied = [rows[pair["second"]] for pair in pairs if pair["p"] >= SIGNIFICANT]
    if not tied:
        return printable(f"{where}, {first['label']} is the best: {figure}. {_lead(board, column)}")
    names = _listed([row["label"] for row in tied])
    return printable(
        f"{where}, {first['label']} is first with {figure}, but cannot be told apart from "
        f"{names}{_fastest(board, [first, *tied])}."
    )


def _fastest(board: BoardData, rows: Sequence[Row]) -> str:
    """Name the row with the least time for a frame, in a unit that all their machines share."""
    shown = {column["name"] for column in board["columns"]}
    unit = {"frame_ms_p50": "ms", "frame_solves": "calibration solves"}
    name = next((name for name in unit if name in shown), None)
    timed = [row for row in rows if name is not None and row[name] is not None]
    if not timed or name is None:
        return ""
    fastest = min(timed, key=lambda row: row[name])
    return f"; the fastest of them is {fastest['label']} ({fastest[name]:.3g} {unit[name]} a frame)"


def _lead(board: BoardData, column: Column) -> str:
    """Describe the difference between the first and the second."""
    rows = board["views"][0]["rows"]
    pair = next((p for p in board["pairs"] if p["first"] == 0), None)
    if pair is None:
        return ""
    p = "p < 0.001" if pair["p"] < 0.001 else f"p = {pair['p']:.3f}"
    low, high = sorted((column.number(abs(pair[end])) for end in ("low", "high")), key=float)
    return (
        f"It is ahead of {rows[pair['second']]['label']} by "
        f"{column.number(abs(pair['difference']))} ({low} to {high}; {p})."
    )


def _listed(names: Sequence[str]) -> str:
    if len(names) > _MOST_NAMES + 1:
        names = [*names[:_MOST_NAMES], f"{len(names) - _MOST_NAMES} others"]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
