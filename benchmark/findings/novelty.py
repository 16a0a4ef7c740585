"""When not to trust an image: how well scores of frames tell conditions that methods do not know.

A scenario may name a `familiar` one, whose condition methods know. Every score of a frame
(`benchmark.metrics.novelty`) is judged by how well it tells the frames of the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.novelty import NOVELTY, SCORES, auroc_and_caught
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, Interval, draw, intervals, once
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import suite_of


@dataclass(frozen=True)
class Told:
    """How well one score of one method tells two scenarios apart.

    Attributes:
        scenario, familiar: whose frames are to be called novel, and whose are not.
        score: a name of `SCORES`.
        figures: of `NOVELTY` by name; the interval is NaN where there are too few sessions.
        n: frames of both.
    """

    scenario: str
    familiar: str
    method: str
    score: str
    figures: dict[str, Interval]
    n: int


def read_novelty(run: Run) -> list[Told]:
    """All scores of a run, by scenario in its order and by method, the best of a scenario first."""
    scores = [name for name in SCORES if name in run.samples]
    if run.kind is not METHOD_RUNS or "residual" not in scores:
        return []
    pairs = [
        (scenario.name, known.name)
        for scenario in suite_of(run.manifest).scenarios
        if (known := suite_of(run.manifest).familiar(scenario)) != scenario
        and {scenario.name, known.name} <= set(run.scenarios())
    ]
    found = []
    for scenario, familiar in pairs:
        of = [
            Told(scenario, familiar, method, score, _figures(rows, score, scenario), len(rows))
            for method in run.cells["method"].unique().tolist()
            for score in scores
            if (rows := _rows(run, method, score, scenario, familiar)) is not None
        ]
        found += sorted(of, key=lambda one: -one.figures["auroc"].value)
    return found


def _rows(run: Run, method: str, score: str, scenario: str, familiar: str) -> pd.DataFrame | None:
    """The samples of a method on both scenarios; None where it lacks the score."""
    known, novel = (run.cell(name, method) for name in (familiar, scenario))
    if novel.empty or known[score].isna().all():
        return None
    return pd.concat([known, novel])


def _figures(rows: pd.DataFrame, score: str, scenario: str) -> dict[str, Interval]:
    # Whatever a frame that failed is charged: it has no image.
    scores = rows[score].where(rows["status"] == "ok").to_numpy(np.float64)
    novel = (rows["scenario"] == scenario).to_numpy()
    clusters = (rows["scenario"] + " " + rows["cluster"]).to_numpy()

    def statistic(counts: np.ndarray) -> np.ndarray:
        return auroc_and_caught(counts, scores, novel)

    whole = once(statistic, len(rows))
    ends = np.full((2, len(whole)), np.nan)
    fewest = min(len(np.unique(clusters[of])) for of in (novel, ~novel))
    if fewest >= MIN_CLUSTERS:
        ends = intervals(whole, draw(statistic, clusters), fewest)
    return {
        name: Interval(*map(float, three))
        for name, three in zip(NOVELTY, zip(whole, *ends, strict=True), strict=True)
    }
