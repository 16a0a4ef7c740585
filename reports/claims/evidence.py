"""Evidence for the published claims: finished runs on the paper's scenario, and studies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.benchmark import InputError
from eitbench.benchmark.analysis.leaderboard import Row, leaderboard_rows
from eitbench.benchmark.analysis.results import Run, failures
from eitbench.benchmark.rundir.few_bytes import with_short_hashes
from eitbench.benchmark.rundir.kinds import SHARED, RunKind
from eitbench.benchmark.rundir.manifest import resume_command
from eitbench.reports.studies.summaries import StudySummary

SCENARIO = "paper"
# Suites of one's own may call other scenarios so.
SUITES = {"method": ("paper", "noise", "shapes", "presses", "objects"), "operator": ("operators",)}


class NotMeasuredError(Exception):
    """The runs do not hold what a claim needs; the message says why."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One method or operator, every sample of it valid.

    Attributes:
        run: the run that holds it.
        row: its row of the leaderboard.
        samples: one row per sample.
    """

    run: Run
    row: Row
    samples: pd.DataFrame

    @property
    def conditions(self) -> str:
        """Description of the samples and their mesh."""
        which = "all" if self.run.manifest["plan"]["limit"] is None else "the first"
        text = f"{which} {len(self.samples):,} test samples of {self.row['scenario']!r}"
        if self.row["scenario"] == SCENARIO:
            text += "; sizes of phantoms are ours, since the paper does not state its own"
        crime = "; from the mesh that is inverted with (inverse crime)"
        return text + crime if self.row["inverse_crime"] else text

    @property
    def machine(self) -> str | None:
        """The processor that times were taken on."""
        machine: str | None = self.row["machine"] or self.run.manifest["machine"]["cpu"]
        return machine


def same_machine(*every: Measured) -> str:
    """The processor that the times of all were taken on, and whether other cells shared it.

    Raises:
        NotMeasuredError: they are of several, whose times do not compare.
    """
    first, *others = dict.fromkeys(measured.machine for measured in every)
    if others:
        raise NotMeasuredError(
            f"Times of {first} and of {others[0]} do not compare: run both on one machine."
        )
    shared = any(measured.row.get("timed") == SHARED for measured in every)
    return f"{first}{', which other cells shared' if shared else ''}"


class Evidence:
    """Runs, summaries of studies by name, and learning curves by method: looks them up."""

    def __init__(
        self,
        runs: Sequence[Run],
        studies: Mapping[str, StudySummary] | None = None,
        curves: Mapping[str, pd.DataFrame] | None = None,
    ) -> None:
        self._runs = runs
        self._studies = studies or {}
        self._curves = curves
        self._rows = [
            (run, row)
            for run in runs
            if run.samples["suite"].isin(SUITES[run.kind.name]).any()
            for row in leaderboard_rows([run])
        ]

    def curves(self) -> Mapping[str, pd.DataFrame]:
        """Return the learning curves of "dnn" and "phydnn".

        Raises:
            NotMeasuredError: one of them has no weights.
        """
        if self._curves is None:
            raise NotMeasuredError("There are no learning curves of DNN and PhyDNN here.")
        return self._curves

    def study(self, name: str) -> StudySummary:
        """Return the summary of the study called `name`.

        Raises:
            NotMeasuredError: there is none.
        """
        if name not in self._studies:
            raise NotMeasuredError(f"There is no study {name!r} here.")
        return self._studies[name]

    def of(self, kind: RunKind, name: str, scenario: str = SCENARIO) -> Measured:
        """Return the measurements of the method or operator `name` on a scenario.

        Raises:
            NotMeasuredError: no run holds it whole, or it failed.
            InputError: several runs hold it.
        """
        holders = [
            (run, row)
            for run, row in self._rows
            if row.get(kind.name) == name and row["scenario"] == scenario
        ]
        if not holders:
            raise NotMeasuredError(self._why_missing(kind, name, scenario))
        if len(holders) > 1:
            raise InputError(
                f"{holders[0][0].path} and {holders[1][0].path} both hold the {kind.name} "
                f"{name!r} on {scenario!r}: give only one of them."
            )
        run, row = holders[0]
        table = run.samples
        samples = table[(table["scenario"] == scenario) & (table[kind.name] == name)]
        if row["coverage"] < 1:
            raise NotMeasuredError(f"{failures(replace(run, samples=samples))[0].rstrip('.')}.")
        if row["data_n"] != len(samples):
            raise NotMeasuredError(
                f"{run.path} holds {len(samples)} of {row['data_n']} samples of {name!r}: finish "
                f"it with `{resume_command(run.path)}`."
            )
        return Measured(run, row, samples)

    def _why_missing(self, kind: RunKind, name: str, scenario: str) -> str:
        for run in self._runs:
            if reason := run.manifest["skipped"].get(f"{scenario}/{name}"):
                return str(reason)
        return f"No run holds the {kind.name} {name!r} on {scenario!r}."

    def paired(
        self,
        kind: RunKind,
        first: str,
        second: str,
        names: Sequence[str],
        scenario: str = SCENARIO,
    ) -> tuple[Measured, NDArray[np.float64], NDArray[np.float64]]:
        """What there is of `first`, and figures `names` (n, k) of both on the same n frames.

        Raises:
            NotMeasuredError: one of them was not measured, or not on the same frames.
            InputError: as `of`.
        """
        one, other = (self.of(kind, name, scenario) for name in (first, second))
        for measured in (one, other):
            if lacking := [name for name in names if name not in measured.samples]:
                raise NotMeasuredError(
                    f"{measured.run.path} has no {lacking[0]!r}: compute it with `eitbench rescore "
                    f"{measured.run.path}`."
                )
        keys = ["sample", "input_hash"]
        known = [with_short_hashes(of.samples) for of in (one, other)]
        both = known[0].merge(known[1], on=keys, suffixes=("", "_other"))
        if not len(one.samples) == len(other.samples) == len(both):
            raise NotMeasuredError(f"{first!r} and {second!r} were not run on the same frames.")
        first_figures, others = (
            both[[f"{name}{side}" for name in names]].to_numpy(np.float64)
            for side in ("", "_other")
        )
        return one, first_figures, others
