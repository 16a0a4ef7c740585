"""Metrics computed again from the reconstructions that a run has stored; no method runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import Run, cells_of, read_run
from eitbench.benchmark.metrics.evaluation import GroundTruth, evaluate
from eitbench.benchmark.metrics.load import LoadCalibration
from eitbench.benchmark.metrics.specs import METRIC_COLUMNS
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.store import SAMPLES, RunStore
from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.similarity import Similarity
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario

Fitted = TypeVar("Fitted", Similarity, LoadCalibration)

FIGURES = (*METRIC_COLUMNS, "cc_undefined")

AT_ONCE = 1024
"""Samples in memory at once; a multiple of the blocks that are scored together."""

ROUNDING = 1e-9
"""Change of a figure, relative and absolute, that another processor's arithmetic may cause."""


@dataclass(frozen=True)
class Rescored:
    """A cell that was scored again.

    Attributes:
        n: its samples.
        changed: those of which a figure changed by more than `ROUNDING`.
        figures: names of the figures that changed.
    """

    scenario: str
    method: str
    n: int
    changed: int
    figures: tuple[str, ...]


def rescored(run: Run) -> Iterator[tuple[Rescored, pd.DataFrame]]:
    """Score every cell of the run from its stored images: what changed, and its new rows.

    Raises:
        InputError: a run of operators, or one whose manifest or images lack something.
        DataCorruptError: its images cannot be read.
    """
    if run.kind != METHOD_RUNS:
        raise InputError(f"{run.path} holds no images to score.")
    if not run.whole:
        raise InputError(
            f"{run.path} is a record, with images of few samples: rescore the run it was made of."
        )
    scenarios = {scenario.name: scenario for scenario in manifests.suite_of(run.manifest).scenarios}
    for (name, method), rows in cells_of(run.samples).items():
        if name not in scenarios:
            raise InputError(f"The suite of {run.path} has no scenario {name!r}.")
        registration = None
        if _truth(scenarios[name]) == "position":
            stored = stored_text(run, name, method, "registration")
            if not stored:
                raise InputError(
                    f"{run.path} does not say how images of {method!r} map to places (its "
                    "registration): run the suite again."
                )
            registration = _parsed(Similarity.from_json, stored, run, method)
        stored = stored_text(run, name, method, "load_calibration")
        calibration = _parsed(LoadCalibration.from_json, stored, run, method) if stored else None
        if calibration is not None and calibration.quantity not in rows:
            raise InputError(
                f"{run.path} does not hold the measured loads of {name!r}: run the suite again."
            )
        parts = []
        for first in range(0, len(rows), AT_ONCE):
            part = rows.iloc[first : first + AT_ONCE]
            images = run.estimates(name, method, part["sample"].tolist())
            if images is None:
                raise InputError(
                    f"{run.path} holds no images of {method!r} on {name!r}: run the suite again."
                )
            images[(part["status"] != "ok").to_numpy()] = np.nan
            truth = _stored(run, scenarios[name], part)
            parts.append(evaluate(truth, images, registration, calibration))
        figures = pd.concat(parts)
        new = rows.assign(**{column: figures[column].to_numpy() for column in FIGURES})
        before, after = (
            table.reindex(columns=list(FIGURES)).to_numpy(np.float64, na_value=np.nan)
            for table in (rows, new)
        )
        changed = ~np.isclose(before, after, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)
        names = tuple(compress(FIGURES, changed.any(axis=0)))
        yield Rescored(name, method, len(new), int(changed.any(axis=1).sum()), names), new


def rescore(path: Path) -> list[Rescored]:
    """Score the run directory `path` again, in place: its `samples.parquet` is replaced.

    Raises:
        InputError, DataCorruptError: as for `rescored`.
        EitbenchError: it cannot be written.
    """
    run = read_run(path)
    found, tables = zip(*rescored(run), strict=True) if len(run.samples) else ((), ())
    if found:
        samples = pd.concat(tables).reindex(run.samples.index)
        store = RunStore(path, METHOD_RUNS)
        store.write_table(SAMPLES, samples)
        noted: list[Any] = run.manifest.get("rescored", [])
        again = {"time": manifests.now(), **manifests.environment()}
        store.write_manifest({**run.manifest, "rescored": [*noted, again]})
    return list(found)


def _truth(scenario: Scenario) -> Literal["conductivity", "position", "classes", "none"]:
    return scenario.recorded_set.truth if isinstance(scenario, RecordedScenario) else "conductivity"


def _stored(run: Run, scenario: Scenario, rows: pd.DataFrame) -> GroundTruth:
    truth = _truth(scenario)
    images = run.scene(scenario.name, rows["sample"].tolist()).truth
    if truth in ("conductivity", "classes") and (images is None or len(images) != len(rows)):
        raise InputError(
            f"{run.path} does not hold the true images of {scenario.name!r}: run the suite again."
        )
    # The table of a run has the columns of all scenarios; what this one lacks is empty here.
    rows = rows.reset_index(drop=True).dropna(axis="columns", how="all")
    return GroundTruth(scenario.name, scenario.nominal_sensor, rows, truth, images, images)


def stored_text(run: Run, scenario: str, method: str, column: str) -> str:
    """Text that the only cell of a method on a scenario holds in a column; "" for none."""
    of = (run.cells["scenario"] == scenario) & (run.cells["method"] == method)
    stored = run.cells[of].get(column, pd.Series(dtype=str)).tolist()
    return stored[0] if len(stored) == 1 and isinstance(stored[0], str) else ""


def _parsed(kind: Callable[[str], Fitted], text: str, run: Run, method: str) -> Fitted:
    try:
        return kind(text)
    except (ValueError, TypeError, RecursionError) as error:
        raise DataCorruptError(
            f"The registration of {method!r} in {run.path}, or its calibration, is damaged."
        ) from error
