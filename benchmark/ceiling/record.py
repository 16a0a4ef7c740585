"""Records of the ceiling: what was drawn once and for all, for boards and reports to read.

`records/SUITE.csv` holds the rows of `figures.frames_table`, `records/SUITE.json` the command,
versions and hashes of the data that made it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from eitbench.benchmark.ceiling.drawing import LIBRARY, PARTICLES, told
from eitbench.benchmark.ceiling.figures import FIGURES, frames_table, summary
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, Interval, bootstrap, means
from eitbench.benchmark.rundir.manifest import environment
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.suites.scenario import Scenario

RECORDS = Path(__file__).parent / "records"


def write_record(
    draws: Path, suite: str, scenarios: Sequence[Scenario], samples: int, out: Path
) -> pd.DataFrame:
    """Write `SUITE.csv` and `SUITE.json` into the folder `out`, from draws; returns the frames.

    Raises:
        InputError: no draws of the scenarios' frames.
    """
    frames = frames_table(draws, scenarios, samples)
    named = ",".join(scenario.name for scenario in scenarios)
    about = {
        "command": f"eitbench ceiling {suite} --scenarios {named} --samples {samples}",
        "particles": PARTICLES,
        "library": LIBRARY,
        "data": {of.name: of.data_hash("test") for of in map(told, scenarios)},
        **environment(),
    }
    table = frames.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    atomic_write(out / f"{suite}.csv", table.encode())
    atomic_write(out / f"{suite}.json", (json.dumps(about, indent=1) + "\n").encode())
    return frames


@lru_cache(maxsize=1)
def _stored() -> tuple[pd.DataFrame, dict[str, str]]:
    """All recorded frames, and the hash of the data of each scenario."""
    tables: list[pd.DataFrame] = []
    data: dict[str, str] = {}
    for path in sorted(RECORDS.glob("*.json")):
        data |= json.loads(path.read_text())["data"]
        tables.append(pd.read_csv(path.with_suffix(".csv")))
    columns = ["scenario", "sample", "input_hash", "mse"]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=columns), data


def recorded_frames(scenario: str) -> pd.DataFrame:
    """The recorded frames of a scenario; no rows where it has none."""
    frames, _ = _stored()
    return frames[frames["scenario"] == scenario]


def ceiling_row(scenario: str, data_hash: str | None) -> dict[str, float] | None:
    """Means of the `FIGURES` over the recorded frames of a scenario; None without a record."""
    _, data = _stored()
    if data_hash is None or data.get(scenario) != data_hash:
        return None
    (row,) = summary(recorded_frames(scenario)).to_dict("records")
    return {name: row[name] for name in (*FIGURES, "n")}


def below_ceiling(
    scenario: str, hashes: Sequence[str], psnr: Array, clusters: Sequence[str]
) -> Interval | None:
    """How far the mean squared error of a method is above that of the ceiling [dB].

    On the frames that both have; None where fewer than `MIN_CLUSTERS` clusters are left.

    Args:
        scenario: name.
        hashes: (n,) of the frames.
        psnr: (n,) [dB] of the method.
        clusters: (n,) see `bootstrap`.
    """
    least = recorded_frames(scenario).set_index("input_hash")["mse"].reindex(list(hashes))
    both = least.notna().to_numpy() & np.isfinite(psnr)
    of = np.asarray(clusters)[both]
    if len(np.unique(of)) < MIN_CLUSTERS:
        return None
    errors = np.stack([10 ** (-psnr[both] / 10), least.to_numpy()[both]], axis=1)
    return bootstrap(errors, of, _decibels)[0]


def _decibels(counts: Array, errors: Array) -> Array:
    mean = means(counts, errors)
    return 10 * np.log10(mean[:, :1] / mean[:, 1:])
