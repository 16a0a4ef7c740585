"""When not to trust an image: how well scores of frames tell conditions that methods do not know.

A scenario may name a `familiar` one, whose condition methods know. Every score of a frame
(`benchmark.metrics.novelty`) is judged by how well it tells the frames of the two apart, and how
well it orders images by their errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.novelty import (
    FRAME,
    NOVELTY,
    SCORES,
    auroc_and_caught,
)
from eitbench.benchmark.metrics.statistics import (
    MIN_CLUSTERS,
    Interval,
    draw,
    intervals,
    once,
    spearman,
)
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import suite_of
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario

NOBODY = "frame alone"
"""Stands in the place of a method: it makes no image."""
_ERROR = "localisation_mm"


@dataclass(frozen=True)
class Told:
    """How well one score of one method tells two scenarios apart.

    Attributes:
        scenario, familiar: whose frames are to be called novel, and whose are not.
        method: `NOBODY` for the score of frames themselves.
        score: a name of `SCORES`.
        figures: of `NOVELTY` by name; the interval is NaN where there are too few sessions, and of
            recordings, whose frames are one course of time.
        n: frames of both.
        failed: of these, frames without an image, which count as the most novel.
    """

    scenario: str
    familiar: str
    method: str
    score: str
    figures: dict[str, Interval]
    n: int
    failed: int


def read_novelty(run: Run, *, with_intervals: bool = True) -> list[Told]:
    """All scores of a run, by scenario in its order, the best of a scenario first.

    Args:
        run: of methods; others have no scores.
        with_intervals: False leaves the intervals NaN, which take most of the time.
    """
    scores = [name for name in SCORES if name in run.samples]
    if run.kind is not METHOD_RUNS or not {"residual", FRAME} <= set(scores):
        return []
    suite, found = suite_of(run.manifest), []
    for scenario in suite.scenarios:
        familiar = suite.familiar(scenario)
        if familiar == scenario or not {scenario.name, familiar.name} <= set(run.scenarios()):
            continue
        of = [
            _told(scenario, familiar, method, score, rows, with_intervals=with_intervals)
            for method in run.cells["method"].unique().tolist()
            for score in scores
            if score != FRAME
            and (rows := _rows(run, method, score, scenario, familiar)) is not None
        ]
        frames = _of_frames(run, scenario, familiar)
        of.append(_told(scenario, familiar, NOBODY, FRAME, frames, with_intervals=with_intervals))
        found += sorted(of, key=lambda one: -one.figures["auroc"].value)
    return found


def _rows(
    run: Run, method: str, score: str, scenario: Scenario, familiar: Scenario
) -> pd.DataFrame | None:
    """The samples of a method on both scenarios; None where an image lacks the score."""
    rows = pd.concat([run.cell(of.name, method) for of in (familiar, scenario)])
    answered = rows[rows["status"] == "ok"]
    if rows["scenario"].nunique() < 2 or answered.empty or answered[score].isna().any():
        return None
    return rows


def _of_frames(run: Run, scenario: Scenario, familiar: Scenario) -> pd.DataFrame:
    """The frames of both scenarios, whatever methods make of them."""
    among = run.samples["scenario"].isin([scenario.name, familiar.name])
    rows = run.samples[among & run.samples[FRAME].notna()]
    rows = rows.drop_duplicates(["scenario", "sample"]).assign(status="ok")
    return rows[["scenario", "sample", "phantom", "cluster", "status", FRAME]]


def _told(
    scenario: Scenario,
    familiar: Scenario,
    method: str,
    score: str,
    rows: pd.DataFrame,
    *,
    with_intervals: bool,
) -> Told:
    answered = (rows["status"] == "ok").to_numpy()
    # Whatever a frame that failed is charged: it has no image.
    values = np.where(answered, rows[score].to_numpy(np.float64), np.inf)
    novel = (rows["scenario"] == scenario.name).to_numpy()
    errors = _errors(rows)

    def statistic(counts: Array) -> Array:
        told = auroc_and_caught(counts, values, novel)
        ordered = (
            np.full(len(counts), np.nan) if errors is None else spearman(counts, values, errors)
        )
        return np.column_stack([told, ordered])

    whole = once(statistic, len(rows))
    ends = np.full((2, len(whole)), np.nan)
    # Sessions of the same number share their unit, and mostly their touches. Where sessions do not
    # differ, clusters have the names of phantoms, which both scenarios may share.
    sessions = [
        str(of) if of == phantom else str(of).removeprefix(str(name))
        for of, phantom, name in rows[["cluster", "phantom", "scenario"]].itertuples(index=False)
    ]
    count = len(set(sessions))
    if with_intervals and count >= MIN_CLUSTERS and not isinstance(scenario, RecordedScenario):
        ends = intervals(whole, draw(statistic, sessions), count)
    figures = {
        name: Interval(*map(float, three))
        for name, three in zip(NOVELTY, zip(whole, *ends, strict=True), strict=True)
    }
    failed = int((~answered).sum())
    return Told(scenario.name, familiar.name, method, score, figures, len(rows), failed)


def _errors(rows: pd.DataFrame) -> NDArray[np.float64] | None:
    """Error (n,) of each image, by what is known of it; None where it is not of every frame."""
    for name, sign in (("psnr", -1.0), (_ERROR, 1.0)):
        if name in rows and rows[name].notna().all():
            return sign * rows[name].to_numpy(np.float64)
    return None
