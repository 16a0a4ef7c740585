"""Runs of scenarios of the kind "transfer": the error over the number of labelled presses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run, cells_of
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.statistics import Interval, bootstrap, medians
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.kinds import PLACE_RUNS
from eitbench.scenarios.suites.scenario import TransferScenario

FEWEST_SKINS = 3
"""Fewer give no interval."""


class SkinError(NamedTuple):
    """Errors of a method on one skin, after so many labelled presses of it.

    Attributes:
        recording: name of the skin's recorded set.
        labelled: number of labelled presses.
        method: name.
        median_mm, p90_mm: median and 90th percentile of the distance of `n` places.
        n: number of places.
    """

    recording: str
    labelled: int
    method: str
    median_mm: float
    p90_mm: float
    n: int


def skin_errors(runs: Sequence[Run]) -> list[SkinError]:
    """Errors of every method on every skin in `runs`; none of other kinds of runs."""
    found = []
    for run in runs:
        if run.kind != PLACE_RUNS:
            continue
        declared = {s.name: s for s in manifest.suite_of(run.manifest).scenarios}
        for (name, method), rows in cells_of(run.samples).items():
            scenario = declared.get(name)
            if isinstance(scenario, TransferScenario):
                error = numbers(rows, "localisation_mm")
                middle, most = np.median(error), np.quantile(error, 0.9)
                figures = float(middle), float(most), len(error)
                found.append(SkinError(scenario.recording, scenario.labelled, method, *figures))
    return found


def over_skins(errors: Sequence[SkinError]) -> pd.DataFrame:
    """The median over skins of the median error, by method and number of labelled presses.

    Returns:
        A row each with `method`, `labelled`, `skins`, `median_mm`, its 95 % interval over skins
        `low_mm` and `high_mm` (NaN for fewer than `FEWEST_SKINS`), and `p90_mm`, the median of the
        skins' 90th percentiles.
    """
    rows = []
    for (method, labelled), of in pd.DataFrame(errors).groupby(["method", "labelled"], sort=False):
        values = of["median_mm"].to_numpy()
        middle = Interval(float(np.median(values)), float("nan"), float("nan"))
        if len(of) >= FEWEST_SKINS:
            middle = bootstrap(values[:, None], of["recording"], medians)[0]
        rows.append(
            {
                "method": method,
                "labelled": labelled,
                "skins": len(of),
                "median_mm": middle.value,
                "low_mm": middle.low,
                "high_mm": middle.high,
                "p90_mm": float(of["p90_mm"].median()),
            }
        )
    return pd.DataFrame(rows).sort_values(["labelled", "median_mm"], ignore_index=True)
