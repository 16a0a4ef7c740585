"""The command that makes the records of the leaderboard."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eitbench.benchmark.rundir.plan import Plan

app = typer.Typer()

VERSION = "2026.2"
"""Of the leaderboard that is being made."""
Version = Annotated[str, typer.Option(help="Of the leaderboard.")]
Records = Annotated[Path, typer.Option(metavar="DIR", help="The records of all versions.")]
RECORDS = Path("reports/board")


@app.command(epilog="Example: eitbench board quick --runs runs/board --version 2026.3")
def board(
    suite: Annotated[str, typer.Argument(help="A packaged suite (eitbench list suites).")],
    runs: Annotated[
        Path, typer.Option(metavar="DIR", help="Where the run goes; a stopped one goes on.")
    ],
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="A,B", help="Run these alone; the others are taken from the last version."
        ),
    ] = None,
    scenarios: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y", help="Run these alone; the others are taken from the last version."
        ),
    ] = None,
    version: Version = VERSION,
    records: Records = RECORDS,
    jobs: Annotated[int, typer.Option(min=1, help="Cells (scenario x method) at a time.")] = 1,
) -> None:
    """Run a whole suite and keep it as a record of the leaderboard, small enough for git.

    It says first what the suite cost when it was recorded last. Records are never edited: what
    changes figures is a new version. It can take the rows of methods that nobody changed from the
    version before.
    """
    from eitbench.benchmark.run.progress import RunProgress
    from eitbench.benchmark.run.runner import make_plan, resume_run, start_run
    from eitbench.benchmark.rundir import manifest
    from eitbench.benchmark.rundir.store import unused
    from eitbench.commands.console import names_in, warn
    from eitbench.reports.board.changes import REASONS, changes, in_words, last_before, reasons
    from eitbench.reports.board.records import calm_ms, check_new, check_version, cost, write_record
    from eitbench.scenarios.errors import InputError, unknown_name
    from eitbench.scenarios.recordings.fetch import fetch_recording
    from eitbench.scenarios.suites.suite import load_suite, suites

    if suite not in suites():
        raise unknown_name("suite", suite, suites())
    if records == RECORDS and not records.is_dir():
        raise InputError(f"There is no {RECORDS} here: run it in a checkout, or name --records.")
    check_version(version)
    declared, out, run = load_suite(suite), records / version / suite, runs / suite
    asked, on = names_in("--methods", methods), names_in("--scenarios", scenarios)
    every = [scenario.name for scenario in declared.scenarios]
    for what, chosen, known in (("method", asked, declared.names), ("scenario", on, every)):
        for name in chosen:
            if name not in known:
                raise unknown_name(f"{what} of suite {suite!r}:", name, known)
    check_new(out)
    older, part = last_before(out), bool(asked or on)
    if part and older is None:
        raise InputError(
            f"No version before {version} has a record of {suite!r} to take the other rows from: "
            "leave --methods and --scenarios out."
        )
    operators = declared.ranks == "operators"
    plan = make_plan(
        declared,
        methods=() if operators else asked,
        operators=asked if operators else (),
        scenarios=on,
    )
    _check_remade(plan.names)
    if held := (run / manifest.FILE_NAME).is_file():
        _check_continues(run, suite, plan)
    elif run.exists() and not (run.is_dir() and unused(run)):
        raise InputError(f"{run} holds something that is no run: name another folder for --runs.")
    elif runs.exists() and not runs.is_dir():
        raise InputError(f"{runs} is a file: name a folder for --runs.")
    for scenario in declared.scenarios:
        for recording in declared.recordings(scenario) if scenario.name in plan.scenarios else ():
            fetch_recording(recording, limit_s=declared.download_limit_s)
    typer.echo(cost(suite, records, asked, on))
    go = partial(resume_run, run, suite=declared) if held else partial(start_run, plan, run)
    result = go(jobs=jobs, calm_ms=calm_ms(records), progress=RunProgress())
    for sentence in (*result.skipped, *result.refused):
        warn(sentence)
    typer.echo(f"Record: {write_record(result.path, out, older if part else None)}")
    if older is not None:
        found, why = changes(older, out), reasons(out.parent)
        for sentence in in_words(found, why):
            typer.echo(sentence)
        if unsaid := (found.changed.keys() | set(found.gone)) - why.keys():
            warn(
                f"Say in {out.parent / REASONS} why {min(unsaid)!r} changed or is gone: tests ask "
                "for it."
            )


def _check_continues(run: Path, suite: str, plan: "Plan") -> None:
    """Check that the run in a folder is of this plan, and was begun by this code.

    Raises:
        InputError: it is not.
    """
    from eitbench.benchmark.rundir import manifest
    from eitbench.scenarios.errors import InputError

    content = manifest.read(run)
    held = content["plan"]
    named, ran = held["names"], held["scenarios"]
    if (held["suite"]["name"], {*named}, {*ran}) != (suite, {*plan.names}, {*plan.scenarios}):
        raise InputError(
            f"{run} holds a run of {', '.join(named)} on {', '.join(ran)}: name another folder "
            "for --runs."
        )
    code = manifest.git_commit()
    if other := [commit for commit in manifest.commits(content) if commit != code]:
        raise InputError(
            f"{run} holds a run by commit {other[0]}, and the code is that of {code}: go on "
            "with that commit, or name another folder for --runs."
        )


def _check_remade(names: Sequence[str]) -> None:
    """Check that a record of these methods or operators can be made again, and lacks none of them.

    Raises:
        InputError: the code is not that of a commit, or a library is missing.
    """
    from eitbench.benchmark.rundir import manifest
    from eitbench.methods.registry import OPERATOR_REGISTRY, place_methods
    from eitbench.scenarios.errors import InputError
    from eitbench.scenarios.extras import missing

    commit = manifest.git_commit()
    if commit is None or commit.endswith("-dirty"):
        raise InputError(
            "A record names the commit that makes it again: run it from a clone of the repository, "
            "with all changes committed."
        )
    known = place_methods() | OPERATOR_REGISTRY.known()
    for name in names:
        needs = getattr(known[name], "needs", "")
        if needs and (why := missing(needs)):
            raise InputError(f"{name!r} belongs to the record, and cannot run here: {why}")
