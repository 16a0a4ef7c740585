"""The gaps between the tracks of a method: its own parameters, the tuned ones, the best on test."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.metrics.aggregation import aggregate
from eitbench.benchmark.metrics.statistics import MIN_PHANTOMS, draw, intervals, once
from eitbench.benchmark.rundir.kinds import METHOD_RUNS

_GAPS = {"tuning_gain": ("tuned", "default"), "oracle_gap": ("oracle", "tuned")}
COLUMNS = (
    *("default_figure", "tuned_figure", "oracle_figure"),
    *(f"{gap}{end}" for gap in _GAPS for end in ("", "_low", "_high")),
)
"""Of a row of a leaderboard, None where other tracks were not run: the ranked figure on each track,
tuned over default, and oracle over tuned; gaps are never negative where they help."""


def track_gaps(
    tracks: pd.DataFrame, main: pd.DataFrame, main_track: str, by: str
) -> dict[str, float]:
    """Compute those of `COLUMNS` that are known of a method on a scenario.

    The intervals are of a paired bootstrap over phantoms; fewer than `MIN_PHANTOMS` give none.

    Args:
        tracks: its rows of the tracks beside the ranked one.
        main: its rows of the ranked track.
        main_track: name of that track; all but "default" are of chosen parameters.
        by: the name of the figure that ranks.
    """
    spec = METHOD_RUNS.metrics[by]
    cells = {str(track): rows for track, rows in tracks.groupby("track")}
    cells["default" if main_track == "default" else "tuned"] = main
    cells = {track: rows.sort_values("sample") for track, rows in cells.items()}
    if len({tuple(rows["sample"]) for rows in cells.values()}) > 1:
        return {}

    def figures(counts: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([aggregate(rows, [spec], counts)[:, 0] for rows in cells.values()], axis=1)

    names, values = list(cells), once(figures, len(main))
    found = {f"{track}_figure": value for track, value in zip(cells, values, strict=True)}
    phantoms = next(iter(cells.values()))["phantom"] if "phantom" in main else pd.Series(dtype=str)
    many = phantoms.nunique() >= MIN_PHANTOMS
    drawn = draw(figures, phantoms) if many else None
    for gap, (better, worse) in _GAPS.items():
        if better in cells and worse in cells:
            one, other = names.index(better), names.index(worse)
            found[gap] = spec.sign * (values[one] - values[other])
            if drawn is not None:
                each = spec.sign * (drawn[:, one] - drawn[:, other])
                ends = intervals(np.array([found[gap]]), each[:, None], phantoms.nunique())
                found[f"{gap}_low"], found[f"{gap}_high"] = ends[:, 0]
    return {name: float(value) for name, value in found.items() if np.isfinite(value)}
