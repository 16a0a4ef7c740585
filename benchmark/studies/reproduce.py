"""Runs of the methods and operators that the published claims are about."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from eitbench.benchmark.run.progress import RunProgress
from eitbench.benchmark.run.runner import RunInterruptedError, resume_run, start_run
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.plan import Plan, make_plan, read_resumable
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import load_suite

METHODS = ("noser", "tv", "dnn", "phydnn")
OPERATORS = ("surrogate", "jacobian", "fem")


def run_claims(
    out: Path, *, limit: int | None = None, jobs: int = 1, progress: RunProgress | None = None
) -> list[Path]:
    """Run what the claims are about in simulation, each suite into its folder in `out`.

    A stopped run is continued; a finished one is taken as it is.

    Raises:
        InputError: `out` holds runs of other choices.
        RunInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        EitbenchError: as `start_run`.
    """
    folders = []
    for plan in _plans(limit):
        folder = out / plan.suite.name
        try:
            if (folder / manifest.FILE_NAME).is_file():
                _check_same(plan, folder)
                resume_run(folder, jobs=jobs, progress=progress)
            else:
                start_run(plan, folder, jobs=jobs, progress=progress)
        except RunInterruptedError as interrupted:
            again = "" if limit is None else f" --limit {limit}"
            raise RunInterruptedError(
                interrupted.reason, f"eitbench reproduce --out {shlex.quote(str(out))}{again}"
            ) from interrupted
        folders.append(folder)
    return folders


def _plans(limit: int | None) -> Sequence[Plan]:
    networks = [load_suite(name) for name in ("shapes", "noise")]
    return (
        make_plan(load_suite("paper"), methods=METHODS, scenarios=["paper"], limit=limit),
        make_plan(load_suite("operators"), operators=OPERATORS, scenarios=["paper"], limit=limit),
        *(make_plan(suite, methods=["dnn", "phydnn"], limit=limit) for suite in networks),
        make_plan(load_suite("objects"), methods=METHODS, limit=limit),
    )


def _check_same(plan: Plan, folder: Path) -> None:
    if read_resumable(folder)[1] != plan:
        raise InputError(
            f"{folder} holds a run with another --limit or of another version: give another --out, "
            f"or take its runs with --runs {folder}."
        )
