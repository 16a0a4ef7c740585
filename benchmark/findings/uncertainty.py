"""What methods state of their uncertainty, judged by the truth: a track of its own.

Only methods that state one are in it, ranked by CRPS, with ties by the test of the board: of paired
differences, adjusted for all pairs of the methods that are ranked here. Where no true conductivity
is known, as on recorded skins, there are figures of the place alone, and no rank. Where the ceiling
is recorded for frames of a run (`benchmark.ceiling`), its posterior is judged like a method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from eitbench.benchmark.analysis.results import Run, in_order
from eitbench.benchmark.analysis.standings import SIGNIFICANT, compared, groups
from eitbench.benchmark.ceiling.record import curves_of, recorded_frames
from eitbench.benchmark.findings.noise import CEILING
from eitbench.benchmark.metrics.aggregation import aggregate
from eitbench.benchmark.metrics.statistics import (
    MIN_CLUSTERS,
    Interval,
    draw,
    intervals,
    once,
)
from eitbench.benchmark.metrics.uncertainty import REMOVED, UNCERTAINTY
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.methods.method import DRAWS
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import DataCorruptError

_Curve = Annotated[list[FiniteFloat], Field(min_length=len(REMOVED), max_length=len(REMOVED))]


class Curves(BaseModel):
    """Means over the frames of a cell.

    Attributes:
        ranks: share of pixels with each rank of the truth among the draws.
        sparsified: mean error [S/m] of the pixels that are left, see `UNCERTAINTY`: when those of
            the largest stated deviation are left out, and when those of the largest error are.
    """

    ranks: Annotated[list[FiniteFloat], Field(min_length=DRAWS + 1, max_length=DRAWS + 1)]
    sparsified: Annotated[list[_Curve], Field(min_length=2, max_length=2)]

    def reliability(self) -> tuple[Array, Array]:
        """Stated and observed shares of truths in central intervals, (K + 1) / 2 + 1 of each."""
        ranks = np.array(self.ranks)
        half = len(ranks) // 2
        inside = [ranks[half - k : half + k].sum() for k in range(half + 1)]
        return np.arange(half + 1) / half, np.array(inside)


@dataclass(frozen=True, eq=False)
class Stated:
    """One method on one scenario.

    Attributes:
        figures: of `UNCERTAINTY` by name; the interval is NaN where there are too few sessions.
        n: frames.
        curves: None where no true conductivity is known.
        rank: by CRPS among the methods that have all frames; None of others, and of the ceiling.
        group: letters, of which methods that cannot be told apart share one; "" without a rank, and
            where there are too few sessions to tell.
    """

    scenario: str
    method: str
    figures: dict[str, Interval]
    n: int
    curves: Curves | None
    rank: int | None = None
    group: str = ""


def read_uncertainty(run: Run) -> list[Stated]:
    """The track of a run, scenario by scenario: the ceiling, which is not ranked, then the best
    method first.

    Raises:
        DataCorruptError: what the run holds of it is damaged.
    """
    names = [name for name in UNCERTAINTY if name in run.samples]
    if (
        run.kind is not METHOD_RUNS
        or "uncertainty" not in run.cells
        or "uncertainty_ms" not in names
    ):
        return []
    cells = run.cells.drop_duplicates(["scenario", "method"]).set_index(["scenario", "method"])
    texts = cells["uncertainty"].to_dict()
    found = []
    for scenario in run.scenarios():
        rows = run.samples[run.samples["scenario"] == scenario]
        track, tables = [], {}
        for method, of in rows.groupby("method", sort=False):
            if of["uncertainty_ms"].notna().any():
                curves = stored_curves(run, texts.get((scenario, method)))
                track.append(Stated(scenario, str(method), _figures(of, names), len(of), curves))
                tables[str(method)] = in_order(of)
        known = recorded_frames(scenario, run.manifest["data"][scenario]["hash"])
        known = known[known["sample"].isin(rows["sample"])]
        stated = [name for name in names if name in known]
        if track and len(known) and stated:
            means = curves_of(known)
            curves = Curves.model_validate(means) if means else None
            found.append(Stated(scenario, CEILING, _figures(known, stated), len(known), curves))
        found += _ranked(track, tables)
    return found


def _ranked(track: list[Stated], tables: Mapping[str, pd.DataFrame]) -> list[Stated]:
    """The methods of a scenario, the best first, with their ranks and ties by CRPS.

    Only those that have all frames are ranked: others may have had easier ones.
    """
    known = [one for one in track if np.isfinite(_crps(one))]
    frames = {one.method: int(tables[one.method]["crps"].notna().sum()) for one in known}
    most = max(frames.values(), default=0)
    whole = sorted((one for one in known if frames[one.method] == most), key=_crps)
    crps = [_crps(one) for one in whole]
    ranked = [
        replace(one, rank=1 + crps.index(_crps(one)), group=group)
        for one, group in zip(whole, _ties(whole, tables), strict=True)
    ]
    return ranked + sorted((one for one in track if one not in whole), key=_crps)


def _ties(whole: list[Stated], tables: Mapping[str, pd.DataFrame]) -> list[str]:
    """The letters of methods on the same frames, the best first."""
    cells, spec = [tables[one.method] for one in whole], UNCERTAINTY["crps"]
    clusters = cells[0]["cluster"].nunique() if cells else 0
    if clusters < MIN_CLUSTERS:
        return [""] * len(cells)

    # In S/m it may be as small as what counts as equal.
    largest = max(cell["crps"].max() for cell in cells)
    cells = [cell.assign(crps=cell["crps"] / largest) for cell in cells]

    def statistic(counts: Array) -> Array:
        return np.concatenate([aggregate(cell, [spec], counts) for cell in cells], axis=1)

    value, drawn = once(statistic, len(cells[0])), draw(statistic, cells[0]["cluster"])
    pairs = compared(cells, np.full(len(cells), len(cells)), spec, value, drawn, clusters)
    return groups(len(cells), [(two.first, two.second) for two in pairs if two.p < SIGNIFICANT])


def _crps(one: Stated) -> float:
    value = one.figures["crps"].value
    return float("inf") if np.isnan(value) else value


def _figures(rows: pd.DataFrame, names: list[str]) -> dict[str, Interval]:
    figures = dict.fromkeys(UNCERTAINTY, Interval(np.nan, np.nan, np.nan))
    # Figures of the same frames share their draws.
    of_frames: dict[bytes, list[str]] = {}
    there = rows[names].notna().to_numpy()
    for name, known_of in zip(names, there.T, strict=True):
        of_frames.setdefault(known_of.tobytes(), []).append(name)
    for frames, together in of_frames.items():
        known = rows.loc[np.frombuffer(frames, dtype=bool), [*together, "cluster"]]
        if len(known):
            figures |= _together(known, together)
    return figures


def _together(known: pd.DataFrame, names: list[str]) -> dict[str, Interval]:
    """Figures of the rows, which have all; their intervals draw sessions, if there are enough."""
    specs = [UNCERTAINTY[name] for name in names]
    table = known[names].to_numpy(np.float64)

    def statistic(counts: Array) -> Array:
        return aggregate(known, specs, counts)

    whole, ends = once(statistic, len(known)), np.full((2, len(names)), np.nan)
    clusters = known["cluster"].nunique()
    if clusters >= MIN_CLUSTERS:
        drawn = intervals(whole, draw(statistic, known["cluster"]), clusters)
        ends = np.where(np.isfinite(table).all(axis=0), drawn, np.nan)
    values = zip(whole.tolist(), *ends.tolist(), strict=True)
    return {name: Interval(*three) for name, three in zip(names, values, strict=True)}


def stored_curves(run: Run, text: object) -> Curves | None:
    """The curves in the column 'uncertainty' of a cell; None where it has none.

    Raises:
        DataCorruptError: the `text` is not what a run writes.
    """
    if not isinstance(text, str) or not text:
        return None
    try:
        return Curves.model_validate_json(text)
    except ValidationError as error:
        raise DataCorruptError(
            f"The column 'uncertainty' of {run.path} is damaged: run the suite again."
        ) from error
