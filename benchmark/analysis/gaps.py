"""The gaps between the tracks of a method: its own parameters, the tuned ones, the best on test."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.metrics.aggregation import aggregate
from eitbench.benchmark.metrics.statistics import MIN_PHANTOMS, draw, intervals, once
from eitbench.benchmark.rundir.kinds import METHOD_RUNS

FIGURES = ("default_figure", "tuned_figure", "oracle_figure")
GAPS = ("tuning_gain", "oracle_gap")
COLUMNS = (*FIGURES, *(f"{gap}{end}" for gap in GAPS for end in ("", "_low", "_high")))
"""What a row of the leaderboard says of tracks, None where they were not run: the ranked figure on
each, tuned over default, and oracle over tuned; gaps are never negative where they help."""


def gaps(
    tracks: pd.DataFrame, main: pd.DataFrame, *, tuned: bool, by: str, clusters: str = "phantom"
) -> dict[str, float]:
    """Some of `COLUMNS` for a method on a scenario.

    Args:
        tracks: its rows of the tracks beside the ranked one.
        main: its rows of the ranked track.
        tuned: whether that is with chosen parameters.
        by: the name of the figure that ranks.
        clusters: column of what is drawn in the paired bootstrap of the intervals; fewer than
            `MIN_PHANTOMS` give none.
    """
    spec = METHOD_RUNS.metrics[by]
    cells = {str(track): rows for track, rows in tracks.groupby("track")}
    cells["tuned" if tuned else "default"] = main
    cells = {track: rows.sort_values("sample") for track, rows in cells.items()}
    if len({tuple(rows["sample"]) for rows in cells.values()}) > 1:
        return {}

    def figures(counts: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([aggregate(rows, [spec], counts)[:, 0] for rows in cells.values()], axis=1)

    values = dict(zip(cells, once(figures, len(main)), strict=True))
    found = {f"{track}_figure": float(value) for track, value in values.items()}
    of = next(iter(cells.values()))[clusters] if clusters in main else None
    drawn = None if of is None or of.nunique() < MIN_PHANTOMS else draw(figures, of)
    names = list(cells)
    for gap, better, worse in zip(GAPS, ("tuned", "oracle"), ("default", "tuned"), strict=True):
        if better in cells and worse in cells:
            found[gap] = spec.sign * (values[better] - values[worse])
            if drawn is not None and of is not None:
                each = spec.sign * (drawn[:, names.index(better)] - drawn[:, names.index(worse)])
                ends = intervals(np.array([found[gap]]), each[:, None], of.nunique())
                found[f"{gap}_low"], found[f"{gap}_high"] = (float(end[0]) for end in ends)
    return {name: float(value) for name, value in found.items() if np.isfinite(value)}
