"""Records of the ceiling, which boards and reports read: what was drawn once and for all.

`records/SUITE.csv` holds the rows of `figures.frames_table`, `records/SUITE.json` the command, the
versions and the hashes of the data that made it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, Interval, bootstrap, means
from eitbench.benchmark.rundir.few_bytes import FRAME_DIGITS, with_short_hashes
from eitbench.scenarios.arrays import Array

RECORDS = Path(__file__).parent / "records"


@lru_cache(maxsize=1)
def _stored() -> tuple[pd.DataFrame, dict[str, str], dict[str, pd.Series]]:
    """All recorded frames, the hash of the data, and the `mse` by frame, of each scenario."""
    tables = [pd.DataFrame(columns=["scenario", "sample", "input_hash", "mse"])]
    data: dict[str, str] = {}
    for path in sorted(RECORDS.glob("*.json")):
        data |= json.loads(path.read_text())["data"]
        tables.append(pd.read_csv(path.with_suffix(".csv")))
    frames = pd.concat(tables[1:] or tables, ignore_index=True)
    frames = with_short_hashes(frames).drop_duplicates(["scenario", "input_hash"], keep="last")
    by_frame = frames.set_index("input_hash").groupby("scenario")["mse"]
    return frames, data, {str(scenario): errors for scenario, errors in by_frame}


def recorded_frames(scenario: str, data_hash: str | None) -> pd.DataFrame:
    """The recorded frames of a scenario with test data of this hash; no rows where it has none."""
    frames, data, _ = _stored()
    known = data_hash is not None and data.get(scenario) == data_hash
    return frames[(frames["scenario"] == scenario) & known]


def frames_among(scenario: str, hashes: Sequence[str]) -> pd.DataFrame:
    """The recorded frames of a scenario that are among the frames with these `hashes`."""
    frames, _, _ = _stored()
    among = frames["input_hash"].isin(_known_by(hashes))
    return frames[(frames["scenario"] == scenario) & among]


def _known_by(hashes: Iterable[str]) -> list[str]:
    # Records of the leaderboard keep no more digits.
    return [of[:FRAME_DIGITS] for of in hashes]


def below_ceiling(
    scenario: str, hashes: Iterable[str], psnr: Array, clusters: ArrayLike
) -> Interval | None:
    """How far the mean squared error of a method is above that of the ceiling [dB].

    On the frames that both have; None where fewer than `MIN_CLUSTERS` clusters are left.

    Args:
        scenario: name.
        hashes: (n,) of the frames.
        psnr: (n,) [dB] of the method.
        clusters: (n,) see `bootstrap`.
    """
    known = _stored()[2].get(scenario)
    if known is None:
        return None
    least = known.reindex(_known_by(hashes)).to_numpy(np.float64)
    both = np.isfinite(least) & np.isfinite(psnr)
    drawn_with = np.asarray(clusters)[both]
    if len(np.unique(drawn_with)) < MIN_CLUSTERS:
        return None
    errors = np.stack([10 ** (-psnr[both] / 10), least[both]], axis=1)
    return bootstrap(errors, drawn_with, decibels)[0]


def decibels(counts: Array, errors: Array) -> Array:
    """How far the mean of the first of `errors` (n, 2) is above that of the second [dB].

    A statistic of `bootstrap`, for each of its draws of clusters.
    """
    mean = means(counts, errors)
    return 10 * np.log10(mean[:, :1] / mean[:, 1:])
