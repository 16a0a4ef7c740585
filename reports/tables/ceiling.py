"""The ceiling beside the rows of a board: what a method that knows the touches' law could reach."""

from collections.abc import Sequence

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.ceiling.record import recorded_frames


def ceiling_rows(board: Sequence[Row]) -> list[Row]:
    """The ceiling as a row like those of `board`, without a rank; none where it is not known."""
    frames = recorded_frames(board[0]["scenario"], board[0]["data_hash"])
    if frames.empty or "method" not in board[0]:
        return []
    found = {name: float(frames[name].mean()) for name in ("psnr", "ssim", "cc", "rie")}
    found["localisation_mm"] = float(frames["localisation_mm"].median())
    return [dict.fromkeys(board[0]) | {"method": "ceiling", "n": len(frames), **found}]


def ceiling_notes(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on the ceiling; none where it is not known."""
    return [
        f"ceiling: the posterior mean of {row['n']} of the frames, by a sampler that is told the "
        "families, their ranges, the noise, the mesh and the electrodes; what frames allow is at "
        "least this, in mean squared error; for other figures it is a reference; methods are "
        "compared with it on the frames that both have"
        for row in ceiling_rows(board)
    ]
