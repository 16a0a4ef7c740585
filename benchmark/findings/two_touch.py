"""From which distance are two touches told apart? From the stored figures of a run.

Two touches, known to be two, are told apart if the two strongest contacts of the image are each
nearer to its own touch than half the distance of both, and than `WITHIN_MM`: one contact between
them cannot be. Whether the image shows two contacts, and no more, is another question; single
touches among them say what a method that always shows two is worth.
"""

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from eitbench.benchmark.analysis.results import cells_of
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.statistics import LEVEL

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
        for distance in np.unique(numbers(cell, DISTANCE)).tolist():
            touches = cell[cell[DISTANCE] == distance]
            wrong = touches["contact_count_error"]
            within = min(WITHIN_MM, distance / 2)
            apart = (touches["farthest_contact_mm"] < within).to_numpy()
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


def least_distance(found: pd.DataFrame) -> float | None:
    """Smallest distance [mm] from which on at least half are told apart; None where there is none.

    Args:
        found: rows of `told_apart` of one scenario and method.
    """
    pairs = found[found["apart"].notna()].sort_values("distance_mm", ascending=False)
    enough = (pairs["apart"] >= 0.5).cumprod().astype(bool)
    return float(pairs["distance_mm"][enough].min()) if enough.any() else None
