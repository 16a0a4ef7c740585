"""The ceiling beside the rows of a board: what a method that knows the touches' law could reach."""

from collections.abc import Sequence

import pandas as pd

from eitbench.benchmark.analysis.leaderboard import Row
from eitbench.benchmark.ceiling.record import recorded_frames, traces_held_between

LEVEL = 95
"""Of the intervals [%] by which draws are called too sure, where they hold fewer truths than that
by more than chance."""


def ceiling_rows(board: Sequence[Row]) -> list[Row]:
    """The ceiling as a row like those of `board`, without a rank; none where it is not known."""
    frames = _frames(board)
    if frames.empty or "method" not in board[0]:
        return []
    found = {name: float(frames[name].mean()) for name in ("psnr", "ssim", "cc", "rie")}
    found["localisation_mm"] = float(frames["localisation_mm"].median())
    return [dict.fromkeys(board[0]) | {"method": "ceiling", "n": len(frames), **found}]


def ceiling_notes(board: Sequence[Row]) -> list[str]:
    """A part of a sentence on the ceiling; none where it is not known."""
    rows = ceiling_rows(board)
    if not rows:
        return []
    said = (
        f"ceiling: the posterior mean of {rows[0]['n']} of the frames, by a sampler that is told "
        "the families, their ranges, the noise, the mesh and the electrodes; what frames allow is "
        "at least this, in mean squared error; for other figures it is a reference; methods are "
        "compared with it by mean squared error, on the frames that both have, so that their "
        "distance is not the difference of the PSNRs shown"
    )
    held = traces_held_between(_frames(board), LEVEL)
    if held and held.high < LEVEL / 100:
        said += (
            f"; its draws are too sure: their {LEVEL} % intervals hold {held.value:.0%} "
            f"({held.low:.0%} to {held.high:.0%}) of the true places, strengths and areas"
        )
    return [said]


def _frames(board: Sequence[Row]) -> pd.DataFrame:
    """What is recorded of the frames of a board, which a limited run has the first of."""
    frames = recorded_frames(board[0]["scenario"], board[0]["data_hash"])
    own: pd.DataFrame = frames[frames["sample"] < board[0]["data_n"]]
    return own
