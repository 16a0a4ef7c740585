"""The claim ledger as plain values: every published claim with its verdict, and their evidence."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from eitbench.benchmark.analysis.results import Run, read_run
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.studies.readings import FILE_NAME as READINGS
from eitbench.reports.claims.claim import Verdict
from eitbench.reports.claims.evidence import SCENARIO, Evidence
from eitbench.reports.claims.published_claims import CLAIMS
from eitbench.reports.claims.published_rows import ReadRow, read_rows
from eitbench.reports.studies.summaries import StudySummary, read_study
from eitbench.reports.tables.columns import printable
from eitbench.reports.tables.published import PAPER

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table


class LedgerEntry(TypedDict):
    """A claim (see `Claim`) and what the runs say of it (see `Judgement`)."""

    id: str
    source: str
    claim: str
    verdict: str
    why: str
    figures: list[dict[str, Any]]
    n: int | None
    conditions: str
    tolerance: str
    command: str


class LedgerRun(TypedDict):
    """Origin of the figures of one run.

    `limit` is None for all test samples; `weights` holds digests by the name of a method.
    """

    run: str
    suite: str
    limit: int | None
    started: str
    command_line: str
    git_commit: str | None
    cpu: str
    data_hash: str | None
    weights: dict[str, str]


class Ledger(TypedDict):
    """Everything that `claims.json` holds; `summary` counts the claims by verdict."""

    paper: str
    written: str
    summary: dict[str, int]
    claims: list[LedgerEntry]
    studies: list[StudySummary]
    readings: list[ReadRow]
    runs: list[LedgerRun]


def claim_ledger(
    runs: Sequence[Path],
    studies: Sequence[Path] = (),
    curves: "Mapping[str, pd.DataFrame] | None" = None,
) -> Ledger:
    """Test every published claim on the run directories, studies and learning curves.

    Raises:
        InputError: a path is no run directory or no study, or several runs hold the same method.
        DataCorruptError: a file of a run is damaged.
    """
    read = [read_run(path) for path in runs]
    readings = [path for path in studies if (path / READINGS).is_file()]
    others = [path for path in studies if path not in readings]
    summaries = {summary["study"]: summary for summary in map(read_study, others)}
    evidence = Evidence(read, summaries, curves)
    judgements = [(claim, claim.judgement(evidence)) for claim in CLAIMS]
    counted = Counter(judgement.verdict for _, judgement in judgements)
    return Ledger(
        paper=PAPER,
        written=manifest.now(),
        summary={verdict.value: counted[verdict] for verdict in Verdict},
        claims=[
            LedgerEntry(
                id=claim.name,
                source=claim.source,
                claim=claim.says,
                verdict=judgement.verdict.value,
                why=judgement.why,
                figures=[asdict(figure) for figure in judgement.figures],
                n=judgement.n,
                conditions=judgement.conditions,
                tolerance=claim.tolerance,
                command=claim.command,
            )
            for claim, judgement in judgements
        ],
        studies=[summaries[name] for name in sorted(summaries)],
        readings=read_rows(readings[-1]) if readings else [],
        runs=[_origin(run) for run in read],
    )


def _origin(run: Run) -> LedgerRun:
    content = run.manifest
    return LedgerRun(
        run=run.path.name,
        suite=content["plan"]["suite"]["name"],
        limit=content["plan"]["limit"],
        started=content["started"],
        command_line=content["command_line"],
        git_commit=content["git_commit"],
        cpu=content["machine"]["cpu"],
        data_hash=content["data"].get(SCENARIO, {}).get("hash"),
        weights={cell["name"]: cell["weights"] for cell in content["cells"] if cell["weights"]},
    )


def table(ledger: Ledger) -> "Table":
    """The verdicts for a terminal."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=box.SIMPLE_HEAD)
    for heading in ("Claim", "Verdict", "Why"):
        shown.add_column(heading, no_wrap=heading != "Why")
    for entry in ledger["claims"]:
        verdict = Text(entry["verdict"], style=_STYLES[entry["verdict"]])
        shown.add_row(entry["id"], verdict, Text(printable(entry["why"])))
    return shown


_STYLES: dict[str, str] = {
    Verdict.holds: "bold green",
    Verdict.in_part: "bold yellow",
    Verdict.fails: "bold red",
    Verdict.undecided: "bold",
    Verdict.untestable: "dim",
}
