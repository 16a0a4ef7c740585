"""Checks a run that is submitted to a public leaderboard: complete, on our data, scored by us."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.benchmark import manifest as manifests
from eitbench.benchmark.kind import METHODS
from eitbench.benchmark.plan import Plan
from eitbench.benchmark.rescore import rescored
from eitbench.benchmark.results import Run, leaderboard_rows, read_run
from eitbench.scenarios.datasets import load
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.scenario import Scenario
from eitbench.scenarios.suites import load_suite, suites

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
    """Everything that is checked of the run directory `path`.

    What cannot be checked from outside is taken on trust: times, and the similarity that maps the
    images of a method onto the robot's frame, which is fitted on validation presses.

    Args:
        jobs: processes to simulate data with.

    Raises:
        InputError: no run directory, or a run of operators.
        DataCorruptError: a table of the run is damaged.
    """
    run = read_run(path)
    if run.kind != METHODS:
        raise InputError(f"{path} ranks operators: a submission is a run of methods.")
    plan = Plan.of(run.manifest, path)
    return [Check(name, check(run, plan, jobs)) for name, check in CHECKS.items()]


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
    for scenario in _scenarios(run, plan):
        data = load(scenario, "test", plan.limit, jobs=jobs)
        told = run.manifest["data"][scenario.name]
        if told["hash"] != data.data_hash:
            return f"The data of {scenario.name!r} are not those of this version of eitbench."
        for name, rows in run.samples[run.samples["scenario"] == scenario.name].groupby("method"):
            ordered = rows.sort_values("sample")
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
        told = json.loads((run.path / LEADERBOARD).read_text(encoding="utf-8"))
        rows = {(row["scenario"], row["method"]): row for row in told}
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"{LEADERBOARD} cannot be read ({type(error).__name__})."
    for row in leaderboard_rows([run]):
        there = rows.get((row["scenario"], row["method"]), {})
        for name in ("rank", "n", "coverage", *METHODS.metrics):
            if there.get(name) != row[name]:
                return (
                    f"{LEADERBOARD} says {name} {there.get(name)} of {row['method']!r} on "
                    f"{row['scenario']!r}, and its samples say {row[name]}."
                )
    return ""


def _scenarios(run: Run, plan: Plan) -> Iterator[Scenario]:
    return (scenario for scenario in plan.suite.scenarios if scenario.name in run.manifest["data"])


def _told(check: Callable[[Run, Plan, int], str]) -> Callable[[Run, Plan, int], str]:
    """`check`, with what it cannot read told as its problem."""

    def checked(run: Run, plan: Plan, jobs: int) -> str:
        try:
            return check(run, plan, jobs)
        except EitbenchError as error:
            return str(error)
        except (KeyError, TypeError, ValueError) as error:
            return f"The {manifests.FILE_NAME} or a table lacks something ({error})."

    return checked


CHECKS: dict[str, Callable[[Run, Plan, int], str]] = {
    "the suite is one of eitbench's": _told(_is_packaged),
    "every sample of every method has its row": _told(_is_complete),
    "frames and truth are ours": _told(_frames_are_ours),
    "figures are those of the stored images": _told(_scores_are_ours),
    "the leaderboard follows from the figures": _told(_leaderboard_follows),
}
