"""A run that is submitted to the leaderboard, and what its folder holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from eitbench.benchmark.analysis.results import (
    NOTES_FILE,
    Run,
    read_run,
    rows_of,
)
from eitbench.benchmark.run.method_cell import MethodData
from eitbench.benchmark.rundir import manifest as manifests
from eitbench.benchmark.rundir.kinds import METHOD_RUNS
from eitbench.benchmark.rundir.plan import Plan, plan_of
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.benchmark.submissions.statement import STATEMENT
from eitbench.scenarios.errors import InputError

LEADERBOARD = "leaderboard.json"

FILES = (
    *(manifests.FILE_NAME, SAMPLES, METHOD_RUNS.table, METHOD_RUNS.arrays),
    *(NOTES_FILE, LEADERBOARD, STATEMENT),
)
"""Of the folder of a submission, beside copies of plugins."""

FOLDER = "submissions"
"""In a version of the leaderboard: SUITE/NAME is a submission."""

STATED = (
    "times and memory (self-reported)",
    "how methods were tuned: track and trials",
    "that they cannot run on what they leave out",
)
"""What is taken on trust of every submission."""

TRUST = (
    *STATED,
    "that its version of eitbench was not changed",
    "what methods say of their prior knowledge and differences, what they were seen to do, "
    "parameters and weights",
    "that the images are what the methods make of the frames",
    "what methods state of their uncertainty and of novel frames",
)
"""What is taken on trust without a rerun."""


@dataclass(frozen=True, eq=False)
class Submission:
    """A run that is checked, with its plan; `jobs` processes simulate our data."""

    run: Run
    plan: Plan
    jobs: int

    @cached_property
    def data(self) -> Mapping[str, MethodData]:
        """Our data of every scenario of the suite, by name.

        Raises:
            DataUnavailableError, DataCorruptError: recorded data cannot be had.
        """
        suite = self.plan.suite
        return {
            scenario.name: MethodData.load(
                scenario, suite, self.plan.limit, jobs=self.jobs, progress=False
            )
            for scenario in suite.scenarios
        }

    @property
    def same_numbers(self) -> bool:
        """True if it was made with the kind of processor, NumPy and SciPy that are here.

        Others may give the frames other last bits.
        """
        theirs, ours = self.run.manifest, manifests.versions()
        same = all(theirs["versions"].get(name) == ours[name] for name in ("numpy", "scipy"))
        return same and theirs["machine"].get("cpu") == manifests.cpu_model()


def open_submission(path: Path, *, jobs: int = 1) -> Submission:
    """Read the run directory `path`, to be checked.

    Raises:
        InputError: no run directory, a record, a run without images, or a changed manifest.
        DataCorruptError: a table of the run is damaged.
    """
    run = read_run(path)
    if not run.whole:
        raise InputError(
            f"{path} is a record, with images of few samples: give the run that it was made of."
        )
    if run.kind != METHOD_RUNS:
        raise InputError(f"{path} holds no images: a submission is a run of imaging methods.")
    try:
        return Submission(run, plan_of(run.manifest, path), jobs)
    except InputError as error:
        raise InputError(
            f"{path} cannot be checked: its manifest was changed. Send what the run wrote."
        ) from error


def unknown_training(of: Submission) -> list[str]:
    """Return the methods whose training data are not known here, so that nothing is checked."""
    return [
        f"{method!r} on {scenario!r}"
        for (scenario, method), rows in rows_of(of.run.cells).items()
        if rows["overlap"].isna().any()
    ]
