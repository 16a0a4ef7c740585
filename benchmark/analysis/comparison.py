"""Changes between two runs on the same frames, and their significance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
import pandas as pd
from scipy import special

from eitbench.benchmark.analysis.results import BUSY, cells_of, checked_table, fastest_solves
from eitbench.benchmark.analysis.standings import SIGNIFICANT
from eitbench.benchmark.metrics.aggregation import aggregate, figure_of, numbers
from eitbench.benchmark.metrics.metric_spec import MetricSpec
from eitbench.benchmark.metrics.specs import METRICS
from eitbench.benchmark.metrics.statistics import (
    EQUAL,
    MIN_CLUSTERS,
    draw,
    holm,
    intervals,
    signed_rank_of,
    student_t,
)
from eitbench.benchmark.metrics.uncertainty import UNCERTAINTY
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.few_bytes import with_short_hashes
from eitbench.benchmark.rundir.kinds import METHOD_RUNS, PINNED
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.storage.try_reading import try_reading

TOO_FEW: Final = "too few to test"
ChangeVerdict = Literal[
    "better",
    "worse",
    "no difference found",
    "within the margin",
    "negligible",
    "equal",
    "too few to test",
]

_NEEDED = ("scenario", "method", "sample", "cluster", "input_hash", "status")
_NEEDED_OF_CELL = ("scenario", "method", "frame_ms_p50", "calibration_ms", "machine", "timed")

COMPARED: Mapping[str, MetricSpec] = {
    name: spec
    for name, spec in (METRICS | UNCERTAINTY).items()
    if spec.best is not None and spec.unit != "ms"
}
"""Figures that can be compared, by name: those of which more, or less, is better."""

NEGLIGIBLE = 1e-3
"""Share of the standard deviation between clusters: what the rounding of another machine's
arithmetic may change, however surely, and what nobody would notice."""


@dataclass(frozen=True)
class Change:
    """One figure of one method on one scenario, before and after.

    Attributes:
        n, clusters: samples that both runs hold, and of how many clusters.
        difference, low, high: after minus before with its 95 % interval.
        p: of no change, two-sided, adjusted for all figures that were compared together (Holm).
        margin: the loss that is allowed.
        p_margin: of a loss that is no larger than the margin, tested and adjusted as `p`, and the
            same as `p` without a margin.
        verdict: "equal" to the last digit; "negligible", see `NEGLIGIBLE`; "better" or "worse"
            beyond chance; "within the margin" where it is worse, but not surely by more; or none
            of these. Fewer than `MIN_CLUSTERS` clusters are "too few to test": then the ends of
            the interval and both p-values are None.
        time_ratio: warm frame after over before, each over the calibration solve beside it; None
            where one of them is not known, or was taken on a busy machine.
        shared: true if one of them was taken beside other cells.
    """

    scenario: str
    method: str
    figure: str
    n: int
    clusters: int
    before: float
    after: float
    difference: float
    low: float | None
    high: float | None
    p: float | None
    margin: float
    p_margin: float | None
    verdict: ChangeVerdict
    time_ratio: float | None
    shared: bool


@dataclass(frozen=True)
class RunComparison:
    """Two runs beside each other.

    Attributes:
        changes: in the order of the earlier run.
        missing: a sentence for each scenario, on the methods of the earlier run that the later one
            does not hold, or not on all of its frames.
        added: a sentence for each that only the later one holds.
        busy: a sentence for each run with times that are not compared, as its machine was busy.
    """

    changes: list[Change]
    missing: list[str]
    added: list[str]
    busy: list[str]


@dataclass(frozen=True)
class FrameTime:
    """Time of a warm frame, and of the calibration solve beside it on the same processor [ms]."""

    frame_ms: float
    solve_ms: float
    machine: str
    shared: bool


@dataclass(frozen=True, eq=False)
class Results:
    """The parts of a run that a comparison needs.

    Attributes:
        path: a run directory, or its `samples.parquet` alone.
        samples: one row per scenario, method and sample.
        times: by scenario and method, where known.
        fastest_ms: the fastest calibration solve of each machine, by its name [ms].
    """

    path: Path
    samples: pd.DataFrame
    times: Mapping[tuple[str, str], FrameTime]
    fastest_ms: Mapping[str, float]


def read_results(path: Path) -> Results:
    """Read a run directory, or the `samples.parquet` of one.

    Raises:
        InputError: it is neither, or a run of operators.
        DataCorruptError: its tables cannot be read.
    """
    try_reading(path, _read_results, path)
    return _read_results(path)


def _read_results(path: Path) -> Results:
    table = path / SAMPLES if path.is_dir() else path
    if not table.is_file():
        raise InputError(
            f"{path} is neither a run directory nor the {SAMPLES} of one: name the folder that "
            "`eitbench run` wrote."
        )
    about: manifest.Manifest = {}
    if (path / manifest.FILE_NAME).is_file():
        about = manifest.read(path)  # nothing is scored by a run of which a part is damaged
    samples = checked_table(table, METHOD_RUNS)
    if "method" not in samples and "operator" in samples:
        raise InputError(f"{path} is a run of operators: only methods are compared.")
    missing = [name for name in _NEEDED if name not in samples]
    if missing:
        raise InputError(
            f"{table} has no column {missing[0]!r}, which a comparison of methods needs: run the "
            "suite again."
        )
    if samples.duplicated(["scenario", "method", "sample"]).any():
        raise InputError(
            f"{table} has several rows for one sample of a method: run the suite again."
        )
    path_of_cells, times, cells = table.with_name(METHOD_RUNS.table), {}, pd.DataFrame()
    if path_of_cells.is_file():
        cells = checked_table(path_of_cells, METHOD_RUNS, _NEEDED_OF_CELL)
        for row in cells.to_dict("records"):
            solve, frame = row["calibration_ms"], row["frame_ms_p50"]
            if solve and frame and np.isfinite(frame / solve):
                key = str(row["scenario"]), str(row["method"])
                times[key] = FrameTime(frame, solve, row["machine"], row["timed"] != PINNED)
    return Results(path, samples, times, fastest_solves(cells, about))


def figure_called(name: str) -> str:
    """Return the name of the figure that has this name, title or heading on its card.

    Raises:
        InputError: there is none.
    """
    for spec in COMPARED.values():
        if name.casefold() in {of.casefold() for of in (spec.name, spec.title, spec.heading)}:
            return spec.name
    raise unknown_name("figure", name, COMPARED)


def compare(
    before: Results, after: Results, margins: Mapping[str, float] = MappingProxyType({})
) -> RunComparison:
    """Compare `after` with `before`, by the figures of `margins`, which may be lost so far.

    Without margins: by the figure that ranks each scenario, and any loss counts.

    Raises:
        InputError: an unknown figure, or nothing that can be compared.
    """
    margins = {figure_called(name): margin for name, margin in margins.items()}
    old, new = cells_of(before.samples), cells_of(after.samples)
    changes = []
    gone: dict[tuple[str, str, str, str], list[str]] = {}
    busy: dict[Path, list[float]] = {}
    fastest = {
        machine: min(of.fastest_ms.get(machine, np.inf) for of in (before, after))
        for machine in {*before.fastest_ms, *after.fastest_ms}
    }
    for (scenario, method), cell in old.items():

        def lost(one: str, several: str, what: str) -> None:
            gone.setdefault((scenario, one, several, what), []).append(repr(method))  # noqa: B023

        if (scenario, method) not in new:
            lost("is", "are", f"only in {before.path}")
            continue
        cells = _common(cell, new[scenario, method])
        clusters = cells[0]["cluster"].nunique()
        if clusters == 0:
            lost("was", "were", f"given other frames in {after.path}")
            continue
        if len(cells[0]) < len(cell):
            lost(
                "lacks",
                "lack",
                f"{len(cell) - len(cells[0])} of the {len(cell)} frames of {before.path} in "
                f"{after.path}: the others are compared",
            )
        times = [of.times.get((scenario, method)) for of in (before, after)]
        ratio, shared = _time_ratio(times, fastest)
        for of, timed in zip((before, after), times, strict=True):
            if timed is not None and _was_busy(timed, fastest):
                slower = timed.solve_ms / fastest[timed.machine]
                busy.setdefault(of.path, []).append(slower)
        for spec in [COMPARED[name] for name in margins] or _ranking(cells[0]):
            figures = [figure_of(cell, spec) for cell in cells]
            if np.isfinite(figures).all():
                change = _change(cells, figures, spec, margins.get(spec.name, 0.0))
                changes.append(
                    replace(
                        change, scenario=scenario, method=method, time_ratio=ratio, shared=shared
                    )
                )
            elif np.isfinite(figures[0]):  # else this scenario does not know it
                lost("has", "have", f"no {spec.title} in {after.path}")
    added = [
        f"{method!r} on {scenario!r} is only in {after.path}."
        for scenario, method in new
        if (scenario, method) not in old
    ]
    missing = [
        f"{', '.join(names)} on {scenario!r} {one if len(names) == 1 else several} {what}."
        for (scenario, one, several, what), names in gone.items()
    ]
    if not changes:
        asked = ", ".join(COMPARED[name].title for name in margins)
        none = f"they share no scenario with {asked}." if asked else "one of them is empty."
        why = (*missing, *added, none)[0]
        raise InputError(f"{before.path} and {after.path} cannot be compared: {why}")
    told = [
        f"Some times in {path} are not compared, as the machine was busy: a fixed computation "
        f"beside them took up to {max(slower):.2f} times as long as it takes when the machine is "
        "idle. Run again on an idle machine with --jobs 1."
        for path, slower in busy.items()
    ]
    return RunComparison(_adjusted(changes), missing, added, told)


def _adjusted(changes: Sequence[Change]) -> list[Change]:
    """The changes with p-values that are adjusted for all that were tested, and their verdicts."""
    found = list(changes)
    tested = [k for k, change in enumerate(changes) if change.p is not None]
    p = np.array([(changes[k].p, changes[k].p_margin) for k in tested], dtype=np.float64)
    for k, adjusted in zip(tested, zip(*map(holm, p.reshape(-1, 2).T), strict=True), strict=True):
        any_change, beyond = map(float, adjusted)
        if not changes[k].margin:  # the p-values of others' margins are none of its own
            beyond = any_change
        verdict = changes[k].verdict
        if any_change < SIGNIFICANT and verdict == "no difference found":
            won = COMPARED[changes[k].figure].sign * changes[k].difference > 0
            sure = beyond < SIGNIFICANT
            verdict = "better" if won else "worse" if sure else "within the margin"
        found[k] = replace(changes[k], p=any_change, p_margin=beyond, verdict=verdict)
    return found


def _was_busy(timed: FrameTime, fastest_ms: Mapping[str, float]) -> bool:
    return timed.solve_ms > BUSY * fastest_ms[timed.machine]


def _time_ratio(
    times: Sequence[FrameTime | None], fastest_ms: Mapping[str, float]
) -> tuple[float | None, bool]:
    """Warm frame after over before in calibration solves, and if one of them is shared."""
    before, after = times
    if before is None or after is None or any(_was_busy(t, fastest_ms) for t in (before, after)):
        return None, False
    ratio = (after.frame_ms / after.solve_ms) / (before.frame_ms / before.solve_ms)
    return ratio, before.shared or after.shared


def _common(*cells: pd.DataFrame) -> list[pd.DataFrame]:
    """The rows of the frames that all cells were given, in one order."""
    frame = ["sample", "input_hash"]
    known = [with_short_hashes(cell) for cell in cells]
    both = known[0][frame]
    for cell in known[1:]:
        both = both.merge(cell[frame])
    return [both.merge(cell) for cell in known]


def _ranking(cell: pd.DataFrame) -> list[MetricSpec]:
    """Return the metric that ranks a cell; none where it is not known."""
    specs = (METRICS[name] for name in METHOD_RUNS.ranked_by)
    return list(islice((s for s in specs if np.isfinite(figure_of(cell, s))), 1))


def _change(
    cells: Sequence[pd.DataFrame], figures: Sequence[float], spec: MetricSpec, margin: float
) -> Change:
    """Change of a figure before its p-values are adjusted."""
    cluster = cells[0]["cluster"]
    clusters = cluster.nunique()
    # The same clusters give both the same draws.
    drawn = [draw(lambda c: aggregate(cell, [spec], c)[:, 0], cluster) for cell in cells]  # noqa: B023
    before, after = figures
    difference, differences = after - before, drawn[1] - drawn[0]
    low, high = map(float, intervals(np.asarray(difference), differences, max(2, clusters)))
    by_sample = spec.name in cells[0]
    values = np.subtract(*(numbers(cell, spec.name) for cell in cells[::-1])) if by_sample else None

    def p_of(shift: float) -> float:
        """P-value that the difference is no other than -`shift`."""
        if spec.aggregate == "median" and values is not None:
            return signed_rank_of(difference + shift, values + shift, cluster)
        t = abs(student_t(difference + shift, differences + shift, clusters))
        return 2 * float(special.stdtr(clusters - 1, -t))

    # A draw may lack what the figure compares, such as untouched frames.
    few = clusters < MIN_CLUSTERS or not np.isfinite(differences).all()
    verdict: ChangeVerdict = TOO_FEW if few else "no difference found"
    # A median stays where it is while frames on one side of it change, however much they do; and
    # of few clusters, all may have the same difference by chance.
    apart = np.zeros(1) if values is None else np.abs(values)
    same = abs(difference) < EQUAL and np.nanmax(apart) < EQUAL
    if same and (by_sample if few else low == high):
        verdict = "equal"
    elif not few:
        noticed = NEGLIGIBLE * float(drawn[0].std()) * np.sqrt(clusters)
        of_frames = float(np.nanmean(apart)) if spec.aggregate == "median" else 0.0
        if max(abs(low), abs(high), of_frames) <= noticed:
            verdict = "negligible"
    lost = -spec.sign * difference
    return Change(
        scenario="",
        method="",
        figure=spec.name,
        n=len(cells[0]),
        clusters=clusters,
        before=before,
        after=after,
        difference=difference,
        low=None if few else low,
        high=None if few else high,
        p=None if few else p_of(0.0),
        margin=margin,
        p_margin=None if few else p_of(spec.sign * margin) if lost > margin else 1.0,
        verdict=verdict,
        time_ratio=None,
        shared=False,
    )
