"""Sentences and small tables that stand below a leaderboard: how its figures are to be read."""

import re
from collections.abc import Sequence

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.reports.tables.columns import Column, layout
from eitbench.reports.tables.published import comparison

_RECORDED = {
    "guess_mm": "guessing one place: {:.1f} mm",
    "reciprocity_error": "reciprocity error of the reference frame: {:.2%}",
    "repeat_noise": "noise between repeats: {:.3%}",
}
_TRACKS = ("default", "tuned", "oracle")
_GAPS = ("tuning_gain", "oracle_gap")


def note(board: Sequence[Row]) -> str:
    """Return `notes` and the quality of recorded data as one line; "" where there is nothing."""
    parts = notes(board)
    for name, form in _RECORDED.items():
        known = [row[name] for row in board if row.get(name) is not None]
        if known:
            parts.append(form.format(known[0]))
    return f"{'; '.join(parts)}." if parts else ""


def notes(board: Sequence[Row]) -> list[str]:
    """Return parts of a sentence on the reading of a board.

    They compare with the published figures, and name the cost of failures, the overlap of training
    and test samples, and differences in software that is not ours.
    """
    return comparison(board) + costs_of_failures(board) + overlaps(board) + _differences(board)


def costs_of_failures(board: Sequence[Row]) -> list[str]:
    """For each method that lost samples, the rank it would have without them, if another."""
    return [
        f"{row['method']} would rank {row['rank_valid']} if what failed were left out"
        for row in board
        if row.get("rank_valid") not in (None, row["rank"]) and row["coverage"] < 1
    ]


def overlaps(board: Sequence[Row]) -> list[str]:
    """For each method, the number of test samples in its training set, unless that is 0."""
    sentences = []
    for row in board:
        if row.get("overlap"):
            total = row["n"] if row["data_n"] is None else row["data_n"]
            sentences.append(
                f"{row['overlap']:.0f} of {total} test samples were in the training set of "
                f"{row['method']}"
            )
        elif row.get("prior_knowledge") and row["overlap"] is None:
            sentences.append(
                f"whether {row['method']} was trained on test samples is not known here"
            )
    return sentences


def prior_knowledge(board: Sequence[Row]) -> list[str]:
    """Return the prior knowledge of the methods of a board, methods with the same together."""
    return _by_text(board, "prior_knowledge")


def _differences(board: Sequence[Row]) -> list[str]:
    return _by_text(board, "differs")


def _by_text(board: Sequence[Row], column: str) -> list[str]:
    """Return each text of a column after the names of the methods that have it."""
    methods: dict[str, list[str]] = {}
    for row in board:
        if text := row.get(column):
            methods.setdefault(text, []).append(row["method"])
    return [f"{', '.join(dict.fromkeys(names))}: {text}" for text, names in methods.items()]


def tracks_table(board: Sequence[Row]) -> list[list[str]]:
    """The heads, then a row for each method that was run on other tracks; empty if none was."""
    rows = [row for row in board if any(row.get(gap) is not None for gap in _GAPS)]
    if not rows:
        return []
    by = layout(board[0]).column(rows[0]["ranked_by"])
    body = []
    for row in rows:
        figures = [row[f"{track}_figure"] for track in _TRACKS]
        texts = ["–" if value is None else by.number(value) for value in figures]
        body.append([row["method"], *texts, *(_gap(row, name, by) for name in _GAPS)])
    return [[by.title, *_TRACKS, "gained by tuning", "left to the oracle"], *body]


def _gap(row: Row, name: str, by: Column) -> str:
    """Return the difference between two tracks with its 95 % interval, if it has one."""
    value, low, high = (row[f"{name}{end}"] for end in ("", "_low", "_high"))
    if value is None:
        return "–"
    # What rounds to 0 has no sign.
    texts = [re.sub(r"^-(?=[0.]*$)", "", by.number(v)) for v in (value, low, high) if v is not None]
    return texts[0] if len(texts) < 3 else f"{texts[0]} ({texts[1]} to {texts[2]})"
