"""What runs show besides leaderboards: noise, ladders, touches, uncertainty, novelty, new skins."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from eitbench.benchmark.analysis.results import read_run
from eitbench.reports.figures.style import STYLE
from eitbench.reports.findings import (
    acuity,
    challenge,
    ladder,
    noise,
    novelty,
    touches,
    transfer,
    uncertainty,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from eitbench.benchmark.analysis.results import Run
    from eitbench.reports.findings.finding import Finding


def findings(runs: Sequence[Run]) -> list[Finding]:
    """Return the findings of runs; where several have one, its stem ends with the run's name."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        makers = (
            challenge.findings, noise.findings, ladder.findings, touches.findings,
            acuity.findings, uncertainty.findings, novelty.findings,
        )  # fmt: skip
        of = [(run, one) for run in runs for make in makers for one in make(run)]
        times = Counter(one.stem for _, one in of)
        named = [
            one if times[one.stem] == 1 else replace(one, stem=f"{one.stem}-{run.path.name}")
            for run, one in of
        ]
        return named + transfer.findings(runs)


def write_findings(path: Path) -> list[Path]:
    """Write tables and figures of the findings of a run into its directory.

    Raises:
        InputError, DataCorruptError: the run cannot be read.
    """
    found = findings([read_run(path)])
    return [file for one in found for file in one.write(path, path / "figures")]
