"""The answer of a board in a few sentences: its best method, and what a reader should know of it.

How sure it is, the fastest of its equals, what ranks, what it was trained on, and where it loses.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

from eitbench.benchmark.analysis.leaderboard import is_whole
from eitbench.benchmark.analysis.standings import SIGNIFICANT, score_weights
from eitbench.reports.tables.columns import Column, layout, listed, printable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eitbench.benchmark.analysis.leaderboard import Row
    from eitbench.reports.page.report_data import BoardData

MOST_ANSWERS = 3
"""Of more scenarios there is one answer for all."""
_MOST_NAMES = 3
_MOST_FIRST = 5


def answer(board: BoardData, boards: Sequence[BoardData] = ()) -> str:
    """Return the best method of a board with its lead, or the methods that it is tied with.

    Args:
        boards: among which to look for one on which the best method of this board loses.
    """
    rows, kind, by = board["views"][0]["rows"], board["kind"], board["ranked_by"]
    where = f"On {board['name']}" + ("" if board["apart"] else f" ({board['n']:,} samples)")
    column = layout(rows[0]).column(by)
    first = rows[0]
    if column is None or first.get(by) is None:
        return printable(f"{where}, no {kind} has a figure to rank by.")
    if not is_whole(first):
        return printable(f"{where}, no {kind} has all samples yet.")
    figure = f"{column.title} {column.number(first[by])}"
    low, high = first.get(f"{by}_low"), first.get(f"{by}_high")
    interval = "" if low is None or high is None else _interval(column, low, high)
    if len(rows) == 1:
        return printable(
            f"{where}, only {first['label']} was run: {figure}{interval}.{_beside(board, boards)}"
        )
    if not interval:
        return printable(f"{where}, {first['label']} is first: {figure}.{_beside(board, boards)}")
    figure += interval
    tied = tied_with_first(board)
    if not tied:
        return printable(
            f"{where}, {first['label']} is the best: {figure}. {_lead(board, column)}"
            f"{_beside(board, boards)}"
        )
    names = _listed([row["label"] for row in tied])
    return printable(
        f"{where}, {first['label']} is first with {figure}, but cannot be told apart from "
        f"{names}{_fastest(board, [first, *tied])}.{_beside(board, boards)}"
    )


def summary(boards: Sequence[BoardData]) -> list[str]:
    """Say on how many boards each method, and each operator, is among the first.

    Boards of one row, or without a row of all samples, say nothing. Where too few samples are
    independent for a test, the first alone counts.
    """
    found = []
    for kind in dict.fromkeys(board["kind"] for board in boards):
        first, ran = Counter[str](), Counter[str]()
        for board in boards:
            rows, by = board["views"][0]["rows"], board["ranked_by"]
            if board["kind"] != kind or len(rows) < 2:
                continue
            if is_whole(rows[0]) and rows[0].get(by) is not None:
                ran.update({str(row[kind]) for row in rows})
                first.update({str(row[kind]) for row in (rows[0], *tied_with_first(board))})
        if not first:
            continue
        order = sorted(first, key=lambda name: (-first[name], ran[name], name))
        told = [f"{name} on {first[name]} of {ran[name]}" for name in order[:_MOST_FIRST]]
        if rest := order[_MOST_FIRST:]:
            told.append(f"{len(rest)} other{'s' * (len(rest) > 1)} on at most {first[rest[0]]}")
        found.append(
            printable(
                f"First, or not to be told apart from the first, of the scenarios that each {kind} "
                f"ran on: {listed(told)}."
            )
        )
    return found


def tied_with_first(board: BoardData) -> list[Row]:
    """The rows that cannot be told apart from the first; none where nothing is tested."""
    rows = board["views"][0]["rows"]
    pairs = [pair for pair in board["pairs"] if pair["first"] == 0]
    return [rows[pair["second"]] for pair in pairs if pair["p"] >= SIGNIFICANT]


def _interval(column: Column, low: float, high: float) -> str:
    return f" (95 %: {column.number(low)} to {column.number(high)})"


def _beside(board: BoardData, boards: Sequence[BoardData]) -> str:
    """Say how far it is from the ceiling, what ranks, what it learned from, and where it loses."""
    first = board["views"][0]["rows"][0]
    parts = []
    if (below := first.get("below_ceiling_db")) is not None:
        low, high = first["below_ceiling_db_low"], first["below_ceiling_db_high"]
        parts.append(
            f"In mean squared error, the frames with a ceiling allow at least {below:.1f} dB more "
            f"(95 %: {low:.1f} to {high:.1f})."
        )
    if board["ranked_by"] == "score":
        share = f"{score_weights()['psnr']:.0%}".replace("%", " %")
        parts.append(f"PSNR has {share} of the weight in S.")
    if first.get("training"):
        parts.append(f"{first['label']} needs training data: {first['training']}.")
    elif first.get("training") == "":
        parts.append(f"{first['label']} needs no training data.")
    lost = [
        (row, other)
        for other in boards
        if other["kind"] == board["kind"]
        for row in other["views"][0]["rows"]
        if row["label"] == first["label"] and _is_beaten(row, other)
    ]
    lost.sort(key=lambda of: of[0]["rank"] / len(of[1]["views"][0]["rows"]), reverse=True)
    if lost:
        where = [
            f"{_ordinal(row['rank'])} of {len(other['views'][0]['rows'])} on "
            f"{other['name']}" + " (a real sensor)" * other["recorded"]
            for row, other in lost
        ]
        parts.append(f"Elsewhere it loses: {_listed(where)}.")
    return "".join(f" {part}" for part in parts)


def _is_beaten(row: Row, board: BoardData) -> bool:
    """True if another method is significantly better; False where nothing is tested."""
    place = board["views"][0]["rows"].index(row)
    return any(p["second"] == place and p["p"] < SIGNIFICANT for p in board["pairs"])


def _ordinal(rank: int) -> str:
    teen = rank % 100 in (11, 12, 13)
    return f"{rank}{'th' if teen else {1: 'st', 2: 'nd', 3: 'rd'}.get(rank % 10, 'th')}"


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
    # An interval may hold 0 where a test of ranks tells two medians apart.
    ahead = math.copysign(1, pair["difference"])
    low, high = (column.number(end) for end in sorted((ahead * pair["low"], ahead * pair["high"])))
    return (
        f"It is ahead of {rows[pair['second']]['label']} by "
        f"{column.number(ahead * pair['difference'])} ({low} to {high}; {p})."
    )


def _listed(names: Sequence[str]) -> str:
    if len(names) > _MOST_NAMES + 1:
        names = [*names[:_MOST_NAMES], f"{len(names) - _MOST_NAMES} others"]
    return listed(names)
