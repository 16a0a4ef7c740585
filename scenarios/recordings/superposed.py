"""Touches of two contacts, made of single presses: the sum of their differences.

A linear sensor would measure such a sum if both places were pressed at once. No sensor is linear,
and no hydrogel: how far superposition holds is measured on real pairs of the same skin
(`eitbench.benchmark.studies.superposition`), and whatever is shown of these touches says that they
are superposed.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.recordings.descriptors import RecordedFrames

DISTANCES_MM = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0, 90.0, 108.0)
"""Distances of the two contacts; 20, 75 and 108 mm are those of real pairs."""
TOLERANCE_MM = 2.5
PAIRS = 40
"""Pairs at each distance, and single presses."""
_SEED = 20


def superposed(recording: RecordedFrames) -> RecordedFrames:
    """Make a test split of pairs of test presses, and of as many single ones as of each distance.

    Both presses of a pair are equally deep, and none is used twice at a distance. The first rows
    hold one touch of each distance, and so on, so that any number of them is balanced. The
    validation split stays one of single presses: methods are registered with them.
    """
    samples = recording.samples.assign(contacts=1, x2_m=np.nan, y2_m=np.nan)
    samples["probe_distance_mm"] = 0.0
    validation = np.flatnonzero(samples["split"] != "test")
    test = np.flatnonzero(samples["split"] == "test")
    change = recording.voltages - recording.reference
    rng = np.random.default_rng(_SEED)
    single = rng.permutation(test)[:PAIRS]
    touches = [(k, 0.0, row, row) for k, row in enumerate(single.tolist())]
    for distance in DISTANCES_MM:
        pairs = _pairs(samples.iloc[test], distance, rng)
        touches += [(k, distance, test[i], test[j]) for k, (i, j) in enumerate(pairs)]
    touches.sort()
    first, second = np.array([touch[2:] for touch in touches]).T
    two = first != second
    pressed = samples.iloc[first].reset_index(drop=True)
    other = samples.iloc[second].reset_index(drop=True)
    pressed.loc[two, "contacts"] = 2
    pressed.loc[two, ["x2_m", "y2_m"]] = other.loc[two, ["x_m", "y_m"]].to_numpy()
    pressed["probe_distance_mm"] = [touch[1] for touch in touches]
    frames = recording.reference + change[first] + np.where(two[:, None], change[second], 0.0)
    return replace(
        recording,
        voltages=np.concatenate([recording.voltages[validation], frames]),
        # The depth of one press says nothing of the strength of two.
        samples=pd.concat([samples.iloc[validation], pressed], ignore_index=True).drop(
            columns="depth_mm", errors="ignore"
        ),
    )


def _pairs(
    presses: pd.DataFrame, distance: float, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Rows of up to `PAIRS` pairs that are about `distance` [mm] apart, each row but once."""
    places = 1e3 * presses[["x_m", "y_m"]].to_numpy()
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    fit: NDArray[np.bool_] = np.abs(apart - distance) <= TOLERANCE_MM
    if "depth_mm" in presses:
        depth = presses["depth_mm"].to_numpy()
        fit &= depth[:, None] == depth
    candidates = np.argwhere(np.triu(fit, 1))
    chosen: list[tuple[int, int]] = []
    used: set[int] = set()
    for i, j in rng.permutation(candidates).tolist():
        if len(chosen) < PAIRS and not {i, j} & used:
            chosen.append((i, j))
            used |= {i, j}
    return chosen
