"""The ceiling beside the rows of a board: what a method that knows the touches' law could reach."""

from collections.abc import Sequence

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.ceiling.record import ceiling_row


def ceiling_rows(board: Sequence[Row]) -> list[Row]:
    """The ceiling as a row like those of `board`, without a rank; none where it is not known."""
    found = _ceiling(board)
    return [dict.fromkeys(board[0]) | {"method": "ceiling", **found}] if found else []


def ceiling_notes(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on the ceiling; none where it is not known."""
    found = _ceiling(board)
    if not found:
        return []
    return [
        f"ceiling: posterior mean of {found['n']} frames by a sampler that is told the families, "
        "their ranges, the noise, the mesh and the electrodes; it is a bound for the mean squared "
        "error, a reference for other figures"
    ]


def _ceiling(board: Sequence[Row]) -> dict[str, float] | None:
    if "method" not in board[0]:
        return None
    return ceiling_row(board[0]["scenario"], board[0]["data_hash"])
