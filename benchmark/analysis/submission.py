"""Checks of a run that is submitted to a leaderboard: complete, on our data, scored by us."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.benchmark.analysis.recording_notes import notes_of
from eitbench.benchmark.analysis.rescore import ROUNDING, rescored
from eitbench.benchmark.analysis.results import NOTES_FILE, Run, cells_of, read_run
from eitbench.benchmark.analysis.standings import standings
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.plan import Plan, plan_of
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.suites.scenario import RecordedScenario, Scenario
from eitbench.scenarios.suites.suite import load_suite, suites

LEADERBOARD = "leaderboard.json"


@dataclass(frozen=True)
class Check:
    """One thing that was checked of a submission.

    Attributes:
        name: what was checked.
        problem: what is wrong, as a sentence; "" where nothing is.
    """

    name: str
    problem: str


def check_submission(path: Path, *, jobs: int = 1) -> list[Check]:
    """Check the run directory `path` by all `CHECKS`.

    What cannot be checked from outside is taken on trust: times, hyper-parameters and tracks, and
    the similarity that maps the images of a method onto the robot's coordinates, which is fitted on
    validation presses.

    Args:
        jobs: processes to simulate data with.

    Raises:
        InputError: no run directory, or a run of operators.
        DataCorruptError: a table of the run is damaged.
    """
    run = read_run(path)
    if run.kind != METHOD_RUNS:
        raise InputError(f"{path} ranks operators: a submission is a run of methods.")
    try:
        plan = plan_of(run.manifest, path)
    except InputError as error:
        raise InputError(
            f"{path} cannot be checked: its manifest or a plugin was changed ({error})."
        ) from error
    return [Check(name, _problem(check, run, plan, jobs)) for name, check in CHECKS.items()]


def _problem(check: Callable[[Run, Plan, int], str], run: Run, plan: Plan, jobs: int) -> str:
    """Problem that `check` finds; what it cannot read is one."""
    try:
        return check(run, plan, jobs)
    except EitbenchError as error:
        return str(error)
    except (KeyError, TypeError, ValueError) as error:
        return f"The {manifests.FILE_NAME} or a table lacks something ({error})."


def _is_packaged(run: Run, plan: Plan, jobs: int) -> str:
    if plan.suite.name not in suites():
        return f"The suite {plan.suite.name!r} is not one of eitbench's."
    if plan.suite != load_suite(plan.suite.name):
        return (
            f"The suite {plan.suite.name!r} of this run is not that of this version of eitbench: "
            "run it again."
        )
    return ""


def _is_complete(run: Run, plan: Plan, jobs: int) -> str:
    if run.manifest["status"] != "finished":
        return f"The run is {run.manifest['status']}: resume it."
    if plan.limit != plan.suite.limit:
        return f"The run was limited to {plan.limit} samples a scenario."
    cells = {(cell["scenario"], cell["name"]) for cell in run.manifest["cells"]}
    for scenario in plan.suite.scenarios:
        for name in plan.names:
            # A method without weights for a sensor is left out by the run itself.
            if f"{scenario.name}/{name}" in run.manifest["skipped"]:
                continue
            if (scenario.name, name) not in cells:
                return f"{name!r} was not run on {scenario.name!r}."
    for cell in run.manifest["cells"]:
        rows = run.cell(cell["scenario"], cell["name"])
        n = run.manifest["data"][cell["scenario"]]["n"]
        if sorted(rows["sample"]) != list(range(n)):
            return (
                f"{cell['name']!r} on {cell['scenario']!r} has {len(rows)} rows, not one for each "
                f"of {n} samples."
            )
    return ""


def _frames_are_ours(run: Run, plan: Plan, jobs: int) -> str:
    cells = cells_of(run.samples)
    for scenario in _scenarios(run, plan):
        data = load(scenario, "test", plan.limit, jobs=jobs)
        if run.manifest["data"][scenario.name]["hash"] != data.data_hash:
            return f"The data of {scenario.name!r} are not those of this version of eitbench."
        for (of, name), ordered in cells.items():
            if of != scenario.name:
                continue
            if ordered["input_hash"].tolist() != data.frame_hashes:
                return f"{name!r} was given other frames of {scenario.name!r} than ours."
            known = data.samples.drop(columns="sample")
            for column in known:
                if column not in ordered or not _same(ordered[column], known[column]):
                    return f"The column {column!r} of {name!r} on {scenario.name!r} was changed."
        scene = run.scene(scenario.name, range(len(data)))
        truth = data.conductivity if data.truth == "conductivity" else data.classes
        if truth is not None and (scene.truth is None or not np.array_equal(scene.truth, truth)):
            return f"The truth that is stored of {scenario.name!r} is not ours."
    return ""


def _same(one: Any, other: Any) -> bool:
    # A column that another scenario of the run lacks is stored as float.
    if other.dtype.kind in "iuf":
        return bool(np.array_equal(one.to_numpy(float), other.to_numpy(float), equal_nan=True))
    return bool(one.astype(str).tolist() == other.astype(str).tolist())


def _failures_are_reported(run: Run, plan: Plan, jobs: int) -> str:
    for (scenario, method), ordered in cells_of(run.samples).items():
        images = run.estimates(scenario, method, ordered["sample"].tolist())
        mask = run.scene(scenario, []).mask
        if images is None:
            return f"There are no images of {method!r} on {scenario!r}."
        whole = np.isfinite(images[:, mask]).all(axis=1)
        if not np.array_equal(whole, ordered["status"] == "ok"):
            return (
                f"The status of {method!r} on {scenario!r} does not say which of its images are "
                "whole."
            )
    return ""


def _scores_are_ours(run: Run, plan: Plan, jobs: int) -> str:
    for cell, _ in rescored(run):
        if cell.changed:
            return (
                f"{cell.changed} of {cell.n} samples of {cell.method!r} on {cell.scenario!r} do "
                f"not have the figures of their images: {', '.join(cell.figures)}."
            )
    return ""


def _leaderboard_follows(run: Run, plan: Plan, jobs: int) -> str:
    try:
        stored = json.loads((run.path / LEADERBOARD).read_text(encoding="utf-8"))
        rows = {(row["scenario"], row["method"]): row for row in stored}
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        return f"{LEADERBOARD} cannot be read ({type(error).__name__})."
    expected = [row for standing in standings([run]) for row in standing.rows]
    if len(stored) != len(expected):
        return f"{LEADERBOARD} has {len(stored)} rows, and its samples make {len(expected)}."
    for row in expected:
        there = rows.get((row["scenario"], row["method"]), {})
        for name, value in row.items():
            # A folder may be renamed.
            if name != "run" and not _agrees(there.get(name), value):
                return (
                    f"{LEADERBOARD} says {name} {there.get(name)} of {row['method']!r} on "
                    f"{row['scenario']!r}, and its samples say {value}."
                )
    return ""


def _agrees(stored: Any, value: Any) -> bool:
    if isinstance(value, float) and isinstance(stored, float | int):
        return bool(np.isclose(stored, value, rtol=ROUNDING, atol=ROUNDING))
    return bool(stored == value)


def _notes_are_ours(run: Run, plan: Plan, jobs: int) -> str:
    for scenario in _scenarios(run, plan):
        if isinstance(scenario, RecordedScenario):
            n = run.manifest["data"][scenario.name]["n"]
            stored = run.notes.get(scenario.name, {})
            for name, value in notes_of(scenario, n).items():
                if not _agrees(stored.get(name), value):
                    return (
                        f"{NOTES_FILE} says {name} {stored.get(name)} of {scenario.name!r}, and "
                        f"its data say {value}."
                    )
    return ""


def _scenarios(run: Run, plan: Plan) -> Iterator[Scenario]:
    return (scenario for scenario in plan.suite.scenarios if scenario.name in run.manifest["data"])


CHECKS: dict[str, Callable[[Run, Plan, int], str]] = {
    "the suite is one of eitbench's": _is_packaged,
    "every sample of every method has its row": _is_complete,
    "frames and truth are ours": _frames_are_ours,
    "figures are those of the stored images": _scores_are_ours,
    "failures are reported": _failures_are_reported,
    "notes on recordings are ours": _notes_are_ours,
    "the leaderboard follows from the figures": _leaderboard_follows,
}
