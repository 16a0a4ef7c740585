"""Commands of the hidden test sets, which are drawn with a secret key."""

from pathlib import Path
from typing import Annotated

import typer

from eitbench.commands.board import RECORDS, VERSION, Records, Version
from eitbench.commands.console import Json, names_in, print_json, print_renderable, warn
from eitbench.commands.runs import all_failed

app = typer.Typer(
    help="Hidden test sets: drawn with a secret key whose hash is published.",
    epilog="Example: eitbench hidden new-key ../board.key",
    no_args_is_help=True,
)


@app.command("new-key", epilog="Example: eitbench hidden new-key ../board.key")
def new_key(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="New file, to be kept secret.")],
) -> None:
    """Make a random key and print its SHA-256, which is published before the key is used."""
    from eitbench.benchmark.submissions.hidden import KEYS
    from eitbench.benchmark.submissions.hidden import new_key as made

    sha256 = made(file)
    typer.echo(f"Key: {file}. Keep it out of every repository.")
    typer.echo(f"Publish its hash in {RECORDS / KEYS}: sha256 = {sha256!r}")


@app.command("run", epilog="Example: eitbench hidden run noise --key ../board.key --out ../hidden")
def run(
    suite: Annotated[str, typer.Argument(help="A packaged suite (eitbench list suites).")],
    key: Annotated[Path, typer.Option(metavar="FILE", help="The secret key.")],
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Folder, kept secret like the key; an interrupted run in it goes on.",
        ),
    ],
    methods: Annotated[
        str | None, typer.Option(metavar="A,B", help="Run these methods only.")
    ] = None,
    scenarios: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Run these scenarios only.")
    ] = None,
    plugin: Annotated[
        list[Path] | None, typer.Option(metavar="FILE.py", help="A file with more methods.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Cells (scenario x method) at a time.")] = 1,
    version: Version = VERSION,
    records: Records = RECORDS,
) -> None:
    """Run methods on touches, units of the sensor and noise that nobody else can draw.

    Methods are isolated: they have no network and cannot read the key. Training and validation data
    are those of the open suite. The same command continues a run that was stopped. The run holds
    the true images, so it stays with the key; `eitbench hidden gap` makes what is published.
    """
    from eitbench.benchmark.run.progress import RunProgress
    from eitbench.benchmark.run.runner import make_plan, resume_run, start_run
    from eitbench.benchmark.rundir.manifest import FILE_NAME
    from eitbench.benchmark.rundir.plan import read_resumable
    from eitbench.benchmark.submissions.hidden import KEYS, hidden_suite, read_key
    from eitbench.benchmark.workers.confinement import check_isolation, check_unreadable
    from eitbench.scenarios.data.simulation import split_folder
    from eitbench.scenarios.errors import InputError, unknown_name
    from eitbench.scenarios.suites.suite import load_suite, suites

    if suite not in suites():
        raise unknown_name("suite", suite, suites())
    found = hidden_suite(load_suite(suite), version, read_key(key), records / KEYS)
    for place in (key, out, split_folder("test")):
        check_unreadable(place)
    check_isolation()
    plan = make_plan(
        found,
        methods=names_in("--methods", methods),
        scenarios=names_in("--scenarios", scenarios),
        plugins=plugin or (),
        isolate=True,
    )
    progress = RunProgress()
    if (out / FILE_NAME).is_file():
        _, held = read_resumable(out)
        of = [(set(p.names), set(p.scenarios), {f.sha256 for f in p.plugins}) for p in (held, plan)]
        if of[0] != of[1]:
            raise InputError(
                f"{out} holds a run of {', '.join(held.names)} on {', '.join(held.scenarios)}: "
                "give the same methods, scenarios and plugins to continue it, or another folder "
                "for --out."
            )
        result = resume_run(out, suite=plan.suite, jobs=jobs, isolate=True, progress=progress)
    else:
        result = start_run(plan, out, jobs=jobs, isolate=True, progress=progress)
    for sentence in (*result.skipped, *result.refused):
        warn(sentence)
    typer.echo(f"Run: {result.path}")
    typer.echo("It holds the true images: keep it as secret as the key until that is retired.")
    if result.refused or all_failed(result.path):
        raise typer.Exit(1)


@app.command("gap", epilog="Example: eitbench hidden gap runs/open ../hidden")
def gap(
    open_run: Annotated[
        Path, typer.Argument(metavar="OPEN", help="A run of the open suite, or its record.")
    ],
    hidden_run: Annotated[
        Path, typer.Argument(metavar="HIDDEN", help="A run of `eitbench hidden run`.")
    ],
    record: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Keep the figures in this version of the leaderboard."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what each method loses on the hidden set, and whether that is more than chance."""
    from eitbench.benchmark.analysis.results import read_run
    from eitbench.benchmark.submissions.hidden import hidden_record, write_hidden
    from eitbench.benchmark.submissions.sums import note_sums
    from eitbench.commands.tables import gaps_table
    from eitbench.reports.tables.gaps import gaps_note

    found = hidden_record(read_run(open_run), read_run(hidden_run))
    path = None if record is None else write_hidden(found, record)
    if path is not None:
        note_sums([path])
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_renderable(gaps_table(found.gaps))
    typer.echo(gaps_note())
    if path is not None:
        typer.echo(f"Record: {path}")
