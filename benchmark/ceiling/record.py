"""Records of the ceiling, which boards and reports read: what was drawn once and for all.

`records/SUITE.csv` holds the rows of `figures.frames_table`, `records/SUITE.json` the command, the
versions and the hashes of the data that made it.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, Interval, bootstrap, means
from eitbench.benchmark.metrics.uncertainty import STORED
from eitbench.scenarios.arrays import Array, Index

RECORDS = Path(__file__).parent / "records"
CURVES = ("ranks", "sparsified")
"""What a record keeps of the draws of a frame besides its figures, as `STORED` has it."""
_NOTHING = pd.DataFrame(
    columns=["scenario", "sample", "version", "input_hash", "mse", "rhat", "effective"]
)


@lru_cache(maxsize=1)
def _stored() -> dict[tuple[str, str | None], pd.DataFrame]:
    """The recorded frames of each scenario and hash of its test data."""
    found: dict[tuple[str, str | None], pd.DataFrame] = {}
    for path in sorted(RECORDS.glob("*.json")):
        data = json.loads(path.read_text())["data"]
        for scenario, frames in pd.read_csv(path.with_suffix(".csv")).groupby("scenario"):
            by_sample = frames.set_index(frames["sample"].to_numpy())
            found[str(scenario), data[scenario]] = by_sample
    return found


def recorded_frames(scenario: str, data_hash: str | None) -> pd.DataFrame:
    """The recorded frames of a scenario with test data of this hash, by sample; often none.

    The hash of what decides the data and the number of the sample say which frame it is. Its bits
    do not: the last ones depend on the processor.
    """
    return _stored().get((scenario, data_hash), _NOTHING)


def recorded_runs(suite: str) -> list[dict[str, Any]]:
    """What made the record of a suite, command, versions and commit; the first run first."""
    path = RECORDS / f"{suite}.json"
    if not path.is_file():
        return []
    last: dict[str, Any] = json.loads(path.read_text())
    earlier: list[dict[str, Any]] = last.pop("earlier", [])
    return [*earlier, {name: last[name] for name in last if name != "data"}]


def below_ceiling(
    scenario: str, data_hash: str | None, samples: Index, psnr: Array, clusters: ArrayLike
) -> Interval | None:
    """How far the mean squared error of a method is above that of the ceiling [dB].

    On the frames that both have; None where fewer than `MIN_CLUSTERS` clusters are left.

    Args:
        scenario, data_hash: see `recorded_frames`.
        samples: (n,) numbers of the frames.
        psnr: (n,) [dB] of the method.
        clusters: (n,) see `bootstrap`.
    """
    known = recorded_frames(scenario, data_hash)
    if known.empty:  # as of most scenarios
        return None
    least = known["mse"].reindex(samples).to_numpy(np.float64)
    both = np.isfinite(least) & np.isfinite(psnr)
    drawn_with = np.asarray(clusters)[both]
    if len(np.unique(drawn_with)) < MIN_CLUSTERS:
        return None
    errors = np.stack([10 ** (-psnr[both] / 10), least[both]], axis=1)
    return bootstrap(errors, drawn_with, decibels)[0]


def curves_of(frames: pd.DataFrame) -> dict[str, list[Any]] | None:
    """Means of `CURVES` over recorded frames; None where the draws of each are all alike."""
    found = {name: np.array([text.split() for text in frames[name]], np.float64) for name in CURVES}
    if not np.isfinite(found["ranks"]).any():
        return None
    return {
        name: np.nanmean(values, axis=0).reshape(STORED[name]).tolist()
        for name, values in found.items()
    }


def traces_held(frames: pd.DataFrame, level: int) -> float:
    """Share of the true traces of recorded frames within central intervals of `level` [%]."""
    return float(_held(frames, level).mean())


def traces_held_between(frames: pd.DataFrame, level: int) -> Interval | None:
    """`traces_held` with its interval over clusters; None where there are few of these."""
    clusters = frames["cluster"].to_numpy()
    if len(np.unique(clusters)) < MIN_CLUSTERS:
        return None
    return bootstrap(_held(frames, level)[:, None], clusters)[0]


def _held(frames: pd.DataFrame, level: int) -> Array:
    """`traces_held` of each frame (n,)."""
    ranks = frames.filter(regex="^rank_").to_numpy(np.float64)
    return np.asarray((np.abs(ranks - 0.5) <= level / 200).mean(axis=1))


def decibels(counts: Array, errors: Array) -> Array:
    """How far the mean of the first of `errors` (n, 2) is above that of the second [dB].

    A statistic of `bootstrap`, for each of its draws of clusters.
    """
    mean = means(counts, errors)
    return 10 * np.log10(mean[:, :1] / mean[:, 1:])
