"""Runs of scenarios of the kind "transfer": the error over the number of labelled presses."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run, cells_of
from eitbench.benchmark.analysis.standings import SIGNIFICANT, groups
from eitbench.benchmark.metrics.aggregation import numbers
from eitbench.benchmark.metrics.statistics import (
    MIN_CLUSTERS,
    Interval,
    bootstrap,
    holm,
    medians,
    signed_rank_of,
)
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.kinds import PLACE_RUNS
from eitbench.scenarios.suites.scenario import TransferScenario

FEWEST_SKINS = 6
"""Fewer give no interval: in more than 5 % of cases they all lie on one side of the median of all
skins, so that not even their whole range is an interval of 95 %."""


class SkinError(NamedTuple):
    """Errors of a method on one skin, after so many labelled presses of it.

    Attributes:
        recording: name of the skin's recorded set.
        labelled: number of labelled presses.
        method: name.
        median_mm, p90_mm: median and 90th percentile of the distance of `n` places.
        n: number of places.
        guess_mm: median distance from the middle of the places, which is what guessing costs.
    """

    recording: str
    labelled: int
    method: str
    median_mm: float
    p90_mm: float
    n: int
    guess_mm: float


def skin_errors(runs: Sequence[Run]) -> list[SkinError]:
    """Errors of every method on every skin in `runs`; none of other kinds of runs.

    Of a cell that several runs hold, the last one counts.
    """
    found: dict[tuple[str, int, str], SkinError] = {}
    for run in runs:
        if run.kind != PLACE_RUNS:
            continue
        declared = {s.name: s for s in manifest.suite_of(run.manifest).scenarios}
        for (name, method), rows in cells_of(run.samples).items():
            scenario = declared.get(name)
            if isinstance(scenario, TransferScenario):
                error = numbers(rows, "localisation_mm")
                places = rows[["expected_x_m", "expected_y_m"]].to_numpy(np.float64)
                guess = 1e3 * np.median(np.hypot(*(places - np.median(places, axis=0)).T))
                key = scenario.recording, scenario.labelled, method
                found[key] = SkinError(
                    *key,
                    median_mm=float(np.median(error)),
                    p90_mm=float(np.quantile(error, 0.9)),
                    n=len(error),
                    guess_mm=float(guess),
                )
    return list(found.values())


def over_skins(errors: Sequence[SkinError]) -> pd.DataFrame:
    """The median over skins of the median error, by method and number of labelled presses.

    Returns:
        A row each with `method`, `labelled`, `skins`, `median_mm`, its 95 % interval over skins
        `low_mm` and `high_mm` (NaN for fewer than `FEWEST_SKINS`), `p90_mm`, the median of the
        skins' 90th percentiles, `guess_mm`, that of their guesses, and the letters of `_ties`.
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
                "guess_mm": float(of["guess_mm"].median()),
            }
        )
    found = pd.DataFrame(rows).sort_values(["labelled", "median_mm"], ignore_index=True)
    letters = {
        (method, labelled): text
        for labelled, of in pd.DataFrame(errors).groupby("labelled")
        for method, text in _ties(of).items()
    }
    keys = zip(found["method"], found["labelled"], strict=True)
    return found.assign(ties=[letters.get(key, "") for key in keys])


def _ties(errors: pd.DataFrame) -> dict[str, str]:
    """Letters of the methods that have all skins: two share one if they cannot be told apart.

    Median errors are paired by skin and compared by the signed-rank test, with Holm's correction
    for all pairs. Fewer than `MIN_CLUSTERS` skins give no letters.
    """
    table = errors.pivot_table(index="recording", columns="method", values="median_mm")
    table = table.dropna(axis="columns")
    middle = table.median().sort_values()
    if len(table) < MIN_CLUSTERS or len(middle) < 2:
        return {}
    pairs = list(combinations(range(len(middle)), 2))
    values = table[middle.index].to_numpy()
    p = holm([
        signed_rank_of(middle.iloc[a] - middle.iloc[b], values[:, a] - values[:, b], table.index)
        for a, b in pairs
    ])  # fmt: skip
    apart = [pair for pair, each in zip(pairs, p, strict=True) if each < SIGNIFICANT]
    return dict(zip(middle.index, groups(len(middle), apart), strict=True))
