"""From which distance are two touches told apart? From the stored figures of a run.

Two touches, known to be two, are told apart if the two strongest contacts of the image are each
nearer to its own touch than half the distance of both, and than `WITHIN_MM`: one contact between
them cannot be. Whether the image shows two contacts, and no more, is another question; single
touches among them say what a method that always shows two is worth.
"""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from eitbench.benchmark.analysis.results import cells_of
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.statistics import LEVEL
from eitbench.scenarios.arrays import Mask

WITHIN_MM = 20.0
DISTANCE = "probe_distance_mm"
_NEEDED = (DISTANCE, "contacts", "contact_count_error", "localisation_mm", "farthest_contact_mm")


def told_apart(samples: pd.DataFrame) -> pd.DataFrame:
    """How well each method tells two touches apart, by their distance; empty without such.

    Args:
        samples: rows of a run, see `Run.samples`.

    Returns:
        One row per scenario, method and distance: `scenario`, `method`, `distance_mm` (0 of single
        touches), `n`, `counted` (share of touches whose number of contacts is right), `apart`
        (share told apart, NaN of single touches) with its interval `low` to `high` (Wilson), and
        `place_mm`, the median over touches of the mean error of their places.
    """
    rows = []
    for (scenario, method), cell in cells_of(samples).items():
        if not set(_NEEDED) <= set(cell) or not (cell["contacts"] == 2).any():
            continue
        distances = numbers(cell, DISTANCE)
        for distance in np.unique(distances[np.isfinite(distances)]).tolist():
            touches = cell[cell[DISTANCE] == distance]
            wrong = touches["contact_count_error"]
            apart = are_apart(touches["farthest_contact_mm"].to_numpy(), distance)
            two = bool((touches["contacts"] == 2).all())
            share = binomtest(int(apart.sum()), len(apart)).proportion_ci(LEVEL, "wilson")
            rows.append(
                {
                    "scenario": scenario,
                    "method": method,
                    "distance_mm": distance,
                    "n": len(touches),
                    "counted": wrong.eq(0).where(wrong.notna()).mean(),
                    "apart": apart.mean() if two else np.nan,
                    "low": share.low if two else np.nan,
                    "high": share.high if two else np.nan,
                    "place_mm": touches["localisation_mm"].median(),
                }
            )
    return pd.DataFrame(rows)


def are_apart(farthest_mm: ArrayLike, distance_mm: ArrayLike) -> Mask:
    """Whether pairs (n,) are told apart, by the farther contact's error and their distance [mm]."""
    return np.asarray(farthest_mm) < np.minimum(WITHIN_MM, np.asarray(distance_mm) / 2)


def least_distance(apart: pd.Series, share: float = 0.5) -> float:
    """Smallest distance [mm] from which on at least `share` are told apart; NaN without one.

    Args:
        apart: share told apart by distance [mm]; NaN counts nowhere.
    """
    enough = (apart.dropna().sort_index(ascending=False) >= share).cumprod().astype(bool)
    return float(enough.index[enough].min()) if enough.any() else float("nan")
