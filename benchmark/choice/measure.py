"""Trials of methods within a time limit: parameters, runs and times, one method after the other."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from eitbench.benchmark.choice.candidates import DRIFT, TOUCHES, candidates, scenarios_of
from eitbench.benchmark.choice.decision import (
    Choice,
    ChosenBy,
    Figure,
    Pick,
    Tried,
    pick,
    sensor_hash,
)
from eitbench.benchmark.metrics.statistics import bootstrap, medians
from eitbench.benchmark.run.progress import RunProgress
from eitbench.benchmark.run.runner import RunInterruptedError, make_plan, start_run
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.manifest import cpu_model
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.rundir.tables import read_parquet
from eitbench.benchmark.tuning.selection import TuningBudget, recorded_selection
from eitbench.benchmark.tuning.trials import LEAST_PRESSES, choose_by_chance
from eitbench.benchmark.tuning.tuner import tune
from eitbench.methods.registry import methods as known_methods
from eitbench.methods.registry import source_hash
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.storage.folders import check_empty
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import Suite

TUNING_SHARE = 0.05
"""Share of the time limit in which the parameters of each method are chosen."""


@dataclass(frozen=True)
class MethodTrial:
    """A finished trial of one method.

    Attributes:
        parameters, chosen_by: see `Tried`.
        samples: rows of all samples of all scenarios.
        cells: one row a scenario, which is the index.
    """

    method: str
    parameters: dict[str, Any]
    chosen_by: ChosenBy
    samples: pd.DataFrame
    cells: pd.DataFrame


def choose(
    name: str,
    out: Path,
    *,
    frame_rate: float = 10.0,
    time_limit_s: float = 300.0,
    methods: Sequence[str] = (),
    progress: RunProgress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Choice:
    """Try the methods that make sense on a sensor, and return the best.

    Args:
        name: of a sensor or a recorded set, or the path of a sensor file (.toml) or a recording
            (.h5).
        out: new folder for the runs and the trials of tuning.
        frame_rate: the deadline [frames/s].
        time_limit_s: for everything [s]; it is exceeded by what cannot be interrupted, such as the
            simulation of touches.
        methods: names; all of `CANDIDATES` by default.
        progress: shows the runs.
        clock: gives the time [s].

    Raises:
        InputError: a frame rate or a limit that is no number above 0, an unknown name, a sensor or
            methods that cannot be used, or a folder that is not empty.
        EitbenchError: no method was finished within the limit.
    """
    numbers = (("frame rate", "frames/s", frame_rate), ("time limit", "seconds", time_limit_s))
    for what, unit, value in numbers:
        if not 0 < value < math.inf:
            raise InputError(f"The {what} is a number of {unit} above 0, got {value:g}.")
    check_empty(out)
    end = clock() + time_limit_s
    suite, note = scenarios_of(name, time_limit_s)
    deciding = suite.scenarios[0]
    names, unusable = candidates(methods, deciding.nominal_sensor)
    progress = progress or RunProgress(quiet=True)
    budget = TuningBudget(seconds=TUNING_SHARE * time_limit_s)
    trials: list[MethodTrial] = []
    stopped: list[str] = []

    def attempt(method: str) -> bool:
        try:
            parameters, chosen_by = parameters_of(deciding, method, suite, budget, out / "tuning")
            plan = make_plan(suite, methods=[method], parameters={method: parameters})
            left = max(end - clock(), 0.0)
            run = start_run(plan, out / "runs" / method, time_limit_s=left, progress=progress)
        except (RunInterruptedError, KeyboardInterrupt):  # what was measured before is enough
            if not trials:
                raise
            stopped.append(method)
            return False
        except EitbenchError as error:  # the others may do better
            unusable[method] = str(error)
            return True
        if run.unfinished:
            return False
        samples, cells = (read_parquet(run.path / name) for name in (SAMPLES, METHOD_RUNS.table))
        trials.append(
            MethodTrial(method, parameters, chosen_by, samples, cells.set_index("scenario"))
        )
        return True

    not_tried = within_limit(names, lambda: clock() < end, attempt)
    if not trials and (failed := [why for name, why in unusable.items() if name in names]):
        raise EitbenchError(f"No method could be measured: {failed[0]}")
    if not trials:
        raise EitbenchError(
            f"No method was finished within {time_limit_s:g} s: give more time with --time-limit."
        )
    return decide(
        trials,
        deciding.name,
        frame_rate,
        asked=name,
        drift=suite.scenarios[-1].kind,
        sensor_sha256=sensor_hash(deciding.nominal_sensor),
        time_limit_s=time_limit_s,
        not_tried=tuple(not_tried),
        stopped=bool(stopped),
        unusable=unusable,
        note=note,
    )


def within_limit(
    names: Sequence[str], in_time: Callable[[], bool], attempt: Callable[[str], bool]
) -> list[str]:
    """Attempt one name after the other while there is time; return those that were not finished.

    Args:
        names: the cheapest first.
        in_time: true while there is time for another.
        attempt: true if it was finished.
    """
    for k, name in enumerate(names):
        if not in_time() or not attempt(name):
            return list(names[k:])
    return []


def parameters_of(
    scenario: Scenario, method: str, suite: Suite, budget: TuningBudget, folder: Path
) -> tuple[dict[str, Any], ChosenBy]:
    """Return parameters chosen on the validation split: those on record, or the best of trials.

    Args:
        scenario: the one that decides.
        budget: of the trials.
        folder: for the record of the trials; the user's own records stay as they are.
    """
    record = recorded_selection(scenario, method, source_hash(known_methods()[method]))
    if record is not None:
        return record["parameters"], "record"
    alone = suite.model_copy(update={"scenarios": (scenario,)})
    if choose_by_chance(load(scenario, split="validation", limit=LEAST_PRESSES)):
        return {}, "few presses"
    found = [of for *_, of in tune(make_plan(alone, methods=[method]), folder, budget=budget)]
    if not found:
        return {}, "none"
    (selection,) = found
    if selection.ended_by == "seconds" and len(selection.trials) < 2:
        return {}, "default"
    return selection.parameters, "no figure" if selection.figure is None else "tuning"


def decide(
    trials: Sequence[MethodTrial], decided_on: str, frame_rate: float, **about: Any
) -> Choice:
    """Return the choice among the methods that were tried.

    Args:
        trials: at least one.
        decided_on: name of the scenario whose place error decides.
        frame_rate: the deadline [frames/s].
        about: the other fields of the choice.
    """
    errors = {name: _errors(trials, name) for name in (decided_on, TOUCHES, DRIFT)}
    drifted = errors[DRIFT]
    if decided_on != TOUCHES and about["drift"] == "simulated":
        # Labelled presses say more than simulated ones, of which only the difference is taken.
        added = np.median(errors[DRIFT].to_numpy() - errors[TOUCHES].to_numpy(), axis=0)
        drifted = errors[decided_on] + added.clip(min=0)
    figures = {name: _figures(table) for name, table in errors.items()}
    with_drift = _figures(drifted)
    tried = []
    for trial in trials:
        frame_ms = float(trial.cells["frame_ms_p95"][decided_on])
        simulated = trial.samples[trial.samples["scenario"] == TOUCHES]
        tried.append(
            Tried(
                method=trial.method,
                parameters=trial.parameters,
                chosen_by=trial.chosen_by,
                place=figures[decided_on][trial.method],
                with_drift=with_drift[trial.method],
                touches=figures[TOUCHES][trial.method],
                drift=figures[DRIFT][trial.method],
                score=float(simulated["score"].mean()),
                bounded=float(simulated["bounded"].mean()),
                frame_ms=frame_ms if math.isfinite(frame_ms) else None,
                in_time=frame_ms * frame_rate <= 1e3,
                coverage=float(trial.cells["coverage"].min()),
            )
        )
    times = {row.method: row.frame_ms for row in tried if row.in_time and row.frame_ms}
    best, drift = (pick(table[list(times)], times) for table in (errors[decided_on], drifted))
    if best is not None and drift is not None and best.method in drift.not_told_from:
        equal = {drift.method, *drift.not_told_from} - {best.method}
        drift = Pick(method=best.method, not_told_from=tuple(sorted(equal)))
    return Choice(
        decided_on=decided_on,
        presses=len(errors[decided_on]),
        frame_rate=frame_rate,
        processor=cpu_model(),
        best=best,
        best_with_drift=drift,
        tried=tuple(sorted(tried, key=lambda row: row.place.value)),
        **about,
    )


def _errors(trials: Sequence[MethodTrial], scenario: str) -> pd.DataFrame:
    """Errors of the place [mm] of every sample, with its cluster as index, and method (columns)."""
    columns = {}
    for trial in trials:
        rows = trial.samples[trial.samples["scenario"] == scenario].sort_values("sample")
        columns[trial.method] = rows["localisation_mm"].to_numpy(np.float64)
    return pd.DataFrame(columns, index=rows["cluster"])


def _figures(errors: pd.DataFrame) -> dict[str, Figure]:
    """Median of each column with its interval."""
    found = bootstrap(errors.to_numpy(), errors.index.to_numpy(), medians)
    return {
        str(name): Figure(value=of.value, low=of.low, high=of.high)
        for name, of in zip(errors, found, strict=True)
    }
