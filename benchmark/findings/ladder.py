"""Degradation of methods on the way from an ideal simulation to real sensors.

The rungs of a ladder are the scenarios of a run that declare `imperfections`: the same touches,
measured by sensors that differ from the nominal one in this or that. On them methods are compared
by B, the mean of SSIM, CC, 1 - RIE and PSNR between fixed ends, from 0 to 1 (S is nearly PSNR
alone). Rungs that differ in `severity` alone form a curve, and the area under it, over the span of
its severities, sums a method up: 1 would be a perfect image whatever the sensor. Recorded
scenarios, of which no true conductivity is known, are the last rungs, by the figure that ranks
them, and without intervals. The differences of simulated rungs are paired touch by touch, and their
intervals drawn over sessions; fewer than `MIN_CLUSTERS` sessions give none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
from eitbench.benchmark.analysis.results import Run
from eitbench.benchmark.metrics.statistics import MIN_CLUSTERS, Interval, bootstrap
from eitbench.benchmark.rundir.manifest import suite_of
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.imperfections.imperfections import Imperfections
from eitbench.scenarios.suites.scenario import (
    TOUCHES,
    RecordedScenario,
    Scenario,
    SimulatedScenario,
)

FIGURE = "bounded"
_LEAST_POINTS = 3


@dataclass(frozen=True)
class Step:
    """One method on one rung.

    Attributes:
        value: mean B.
        loss: B lost against the ideal sensor; None where the run has no ideal rung.
        gain: B won by calibration; None where the run has no such rung.
    """

    value: Interval
    loss: Interval | None
    gain: Interval | None


@dataclass(frozen=True)
class Real:
    """One method on one recorded set: the figure that ranks it there, nominal and calibrated."""

    figure: str
    value: float | None
    calibrated: float | None


@dataclass(frozen=True)
class Ladder:
    """The results of a run on its ladder.

    Attributes:
        rungs: scenarios of the simulated rungs, without twins, in the order of the suite but for
            those of the curve, which follow each other.
        methods: by falling area, or by B on the last rung where there is no curve.
        lacking: methods that lack touches of a rung, which may be the harder ones. What they did
            there is compared with no other method.
        steps: by rung and method, of methods that ran there on all touches.
        distances: of the nominal model from what a touch changes on each rung [dB], the median
            over touches, where the model is not that of the data.
        severities: of the rungs of the curve; empty where there is none.
        curves: mean B (points,) of every method, nominal and, where it ran, calibrated.
        areas: under the curve, with its interval; the same for the calibrated one.
        real: by recorded set and method.
    """

    rungs: tuple[str, ...]
    methods: tuple[str, ...]
    lacking: tuple[str, ...]
    steps: dict[tuple[str, str], Step]
    distances: dict[str, float]
    severities: dict[str, float]
    curves: dict[tuple[str, bool], Array]
    areas: dict[tuple[str, bool], Interval]
    real: dict[tuple[str, str], Real]


def read_ladder(run: Run) -> Ladder | None:
    """Compute the ladder of a run of methods; None if it has fewer than two rungs."""
    declared = run.manifest["plan"]["suite"]["scenarios"]
    if run.kind.name != "method" or not any(s.get("ladder") for s in declared):
        return None
    suite = suite_of(run.manifest)
    present = set(run.scenarios())
    scenarios = [s for s in suite.scenarios if s.name in present]
    rungs = [s for s in scenarios if isinstance(s, SimulatedScenario) and s.ladder]
    nominal = [s for s in rungs if not s.calibrated]
    curve = _curve(nominal)
    nominal = _together(nominal, curve)
    if len(nominal) < 2:
        return None
    twins = {s.name: twin.name for s in scenarios if (twin := _twin(s, scenarios))}
    clean = [s for s in nominal if s.noise.test == "clean"]
    ideal = next((s.name for s in clean if s.imperfections == Imperfections()), None)
    samples = run.samples[run.samples[FIGURE].notna()]
    touches_of = samples.groupby(["scenario", "method"])["sample"].transform("size")
    whole = touches_of == touches_of.groupby(samples["scenario"]).transform("max")
    lacking = samples.loc[~whole, "method"].unique()
    samples = samples[whole]
    methods = [str(method) for method in samples["method"].unique()]
    touches = samples.pivot_table(FIGURE, "sample", ["scenario", "method"], "first")
    columns: dict[tuple[str | None, str], int] = {
        (str(column[0]), str(column[1])): k for k, column in enumerate(touches.columns)
    }
    table, numbers = touches.to_numpy(np.float64, na_value=np.nan), touches.index.to_numpy()

    def together(cells: Sequence[tuple[str | None, str]]) -> tuple[Array, NDArray[np.int64]] | None:
        """B (touches, cells) of several cells, with the touches' numbers.

        None where a cell is missing or lacks other touches.
        """
        if not all(cell in columns for cell in cells):
            return None
        values = table[:, [columns[cell] for cell in cells]]
        there = ~np.isnan(values).all(axis=1)
        found = values[there]
        return None if np.isnan(found).any() else (found, numbers[there])

    def difference(scenario: str | None, other: str, method: str) -> Interval | None:
        found = together([(scenario, method), (other, method)])
        return None if found is None else _mean(found[0][:, 0] - found[0][:, 1], found[1])

    steps = {
        (rung.name, method): Step(
            value=_mean(found[0][:, 0], found[1]),
            loss=difference(ideal, rung.name, method),
            gain=difference(twins.get(rung.name), rung.name, method),
        )
        for rung in nominal
        for method in methods
        if (found := together([(rung.name, method)])) is not None
    }
    severities = {s.name: s.imperfections.severity for s in curve}
    curves, areas = {}, {}
    for method, calibrated in product(methods if curve else (), (False, True)):
        names = [twins.get(s.name) if calibrated else s.name for s in curve]
        found = together([(name, method) for name in names])
        if found is not None:
            curves[method, calibrated] = found[0].mean(axis=0)
            at = list(severities.values())
            area = np.asarray(np.trapezoid(found[0], at, axis=1))
            areas[method, calibrated] = _mean(area / (at[-1] - at[0]), found[1])

    def merit(method: str) -> float:
        if (method, False) in areas:
            return -areas[method, False].value
        step = steps.get((nominal[-1].name, method))
        return -step.value.value if step else np.inf

    return Ladder(
        rungs=tuple(s.name for s in nominal),
        methods=tuple(sorted(methods, key=merit)),
        lacking=tuple(map(str, lacking)),
        steps=steps,
        distances=_distances(samples),
        severities=severities,
        curves=curves,
        areas=areas,
        real=_real(run, [s for s in scenarios if isinstance(s, RecordedScenario)], twins),
    )


def _distances(samples: pd.DataFrame) -> dict[str, float]:
    if "model_distance_db" not in samples:
        return {}
    medians = samples.groupby("scenario")["model_distance_db"].median()
    return {str(rung): float(value) for rung, value in medians.items() if np.isfinite(value)}


def _mean(values: Array, touches: NDArray[np.int64]) -> Interval:
    """Mean of values (n,) of touches with these numbers (n,), with its interval over sessions."""
    sessions = touches // TOUCHES
    if len(np.unique(sessions)) < MIN_CLUSTERS:
        return Interval(float(values.mean()), np.nan, np.nan)
    return bootstrap(values[:, None], sessions)[0]


def _twin(scenario: Scenario, scenarios: Sequence[Scenario]) -> Scenario | None:
    """The scenario that is calibrated and else the same."""
    if scenario.calibrated:
        return None
    wanted = scenario.model_copy(update={"calibrated": True})
    return next(
        (s for s in scenarios if s.model_copy(update={"name": wanted.name}) == wanted), None
    )


def _curve(rungs: Sequence[SimulatedScenario]) -> list[SimulatedScenario]:
    """The most rungs that differ in severity (and name) alone, by severity."""

    def apart_from_severity(rung: SimulatedScenario) -> SimulatedScenario:
        imperfections = rung.imperfections.model_copy(update={"severity": 1.0})
        return rung.model_copy(update={"name": "rung", "imperfections": imperfections})

    groups: dict[str, list[SimulatedScenario]] = {}
    for rung in rungs:
        groups.setdefault(apart_from_severity(rung).model_dump_json(), []).append(rung)
    largest = max(groups.values(), key=len, default=[])
    by_severity = {s.imperfections.severity: s for s in largest}
    if len(by_severity) < _LEAST_POINTS:
        return []
    return [by_severity[severity] for severity in sorted(by_severity)]


def _together(
    rungs: Sequence[SimulatedScenario], curve: Sequence[SimulatedScenario]
) -> list[SimulatedScenario]:
    """The rungs with those of the `curve`, by severity, where the first of them stands."""
    if not curve:
        return list(rungs)
    first = min(rungs.index(rung) for rung in curve)
    return [*rungs[:first], *curve, *(rung for rung in rungs[first:] if rung not in curve)]


def _real(
    run: Run, scenarios: Sequence[RecordedScenario], twins: dict[str, str]
) -> dict[tuple[str, str], Real]:
    if not scenarios:
        return {}
    names = {name for s in scenarios for name in (s.name, twins.get(s.name))}
    shown = replace(run, samples=run.samples[run.samples["scenario"].isin(names)])
    rows = {(row["scenario"], row["method"]): row for row in leaderboard_rows([shown])}
    found = {}
    for scenario in (s for s in scenarios if not s.calibrated):
        for (name, method), row in rows.items():
            figure = next((f for f in run.kind.ranked_by if row.get(f) is not None), None)
            if name == scenario.name and figure is not None:
                twin = rows.get((twins.get(name), method), {})
                found[name, method] = Real(figure, row[figure], twin.get(figure))
    return found
