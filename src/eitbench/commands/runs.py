"""Commands that run suites, or score what was run."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eitbench.commands.console import (
    Json,
    names_in,
    new_folder,
    print_json,
    print_renderable,
    warn,
    width,
)

if TYPE_CHECKING:
    from eitbench.benchmark.run.runner import Plan, RunResult

Limit = Annotated[int | None, typer.Option(min=1, help="Test samples of each scenario.")]
Isolate = Annotated[
    bool,
    typer.Option(
        "--isolate",
        help="Let methods use no network and read no files of others (Linux).",
    ),
]
Jobs = Annotated[int, typer.Option(min=1, help="Cells (scenario x method) at a time.")]

app = typer.Typer()


@app.command(epilog="Example: eitbench run quick --methods noser,tv --limit 12 --out runs/first")
def run(
    suite: Annotated[
        str | None, typer.Argument(help="A suite's name, or the path of a suite file (.toml).")
    ] = None,
    methods: Annotated[
        str | None, typer.Option(metavar="A,B", help="Run these methods only.")
    ] = None,
    operators: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Run these forward operators only (suite `operators`)."),
    ] = None,
    scenarios: Annotated[
        str | None,
        typer.Option(metavar="X,Y", help="These scenarios only, with their familiar ones."),
    ] = None,
    limit: Limit = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Simulate this sensor, a file of one (.toml), or that of a recorded set instead.",
        ),
    ] = None,
    plugin: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE.py", help="A file with more methods or operators."),
    ] = None,
    tracks: Annotated[
        str | None,
        typer.Option(
            metavar="A,B", help="Run these tracks beside the ranked one: default, tuned, oracle."
        ),
    ] = None,
    jobs: Jobs = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run the cells on the cluster of a Dask scheduler."),
    ] = None,
    isolate: Isolate = False,
    parameters: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|JSON",
            help='Parameters of methods instead of selected ones: {"noser": {"weight": 0.1}}.',
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option(
            min=0, metavar="SECONDS", help="Stop after that time; --resume continues the run."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder (default: runs/SUITE-TIME).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Continue the run in DIR, in place.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a suite and print its leaderboard."""
    from eitbench.benchmark.run.progress import RunProgress
    from eitbench.benchmark.run.runner import resume_run, start_run
    from eitbench.benchmark.workers.confinement import check_isolation
    from eitbench.scenarios.suites.suite import load_suite

    choices = (
        methods,
        operators,
        scenarios,
        limit,
        sensor,
        plugin or None,
        tracks,
        parameters,
        out,
    )
    if resume is not None and any(choice is not None for choice in choices):
        raise typer.BadParameter(
            "a resumed run keeps its choices: only --jobs, --scheduler, --isolate and --time-limit "
            "may be others"
        )
    if resume is None and suite is None:
        raise typer.BadParameter("name a suite (eitbench list suites), or give --resume DIR")
    progress = RunProgress()
    if resume is not None:
        chosen = None if suite is None else load_suite(suite)
        result = resume_run(
            resume,
            suite=chosen,
            jobs=jobs,
            scheduler=scheduler,
            isolate=isolate,
            time_limit_s=time_limit,
            progress=progress,
        )
    elif suite is not None:
        if isolate:
            check_isolation()  # before a plugin is loaded
        plan = asked_plan(
            suite,
            methods,
            scenarios,
            limit,
            plugin,
            operators,
            tracks,
            parameters,
            isolate=isolate,
            sensor=sensor,
        )
        folder = out or new_folder(plan.suite.name)
        result = start_run(
            plan,
            folder,
            jobs=jobs,
            scheduler=scheduler,
            isolate=isolate,
            time_limit_s=time_limit,
            progress=progress,
        )
    _show_run(result, as_json, limit)
    if result.refused or all_failed(result.path):
        raise typer.Exit(1)


def asked_plan(
    suite: str,
    methods: str | None,
    scenarios: str | None,
    limit: int | None,
    plugins: Sequence[Path] | None,
    operators: str | None = None,
    tracks: str | None = None,
    parameters: str | None = None,
    *,
    isolate: bool = False,
    sensor: str | None = None,
) -> "Plan":
    """Make the plan of a command; names are lists with commas."""
    from eitbench.benchmark.run.runner import make_plan
    from eitbench.benchmark.rundir.plan import read_parameters
    from eitbench.scenarios.declaration import field_error
    from eitbench.scenarios.errors import InputError
    from eitbench.scenarios.suites.suite import load_suite, on_sensor, suites

    chosen = load_suite(suite)
    if sensor is not None:
        chosen = on_sensor(chosen, sensor)
    try:
        return make_plan(
            chosen,
            methods=names_in("--methods", methods),
            operators=names_in("--operators", operators),
            scenarios=names_in("--scenarios", scenarios),
            limit=limit,
            plugins=plugins or (),
            tracks=names_in("--tracks", tracks),
            parameters=None if parameters is None else read_parameters(parameters),
            isolate=isolate,
        )
    except InputError as error:
        # What it ranks is unknown to scenarios, so that only here a suite's own can be wrong.
        own = methods is None and operators is None and suite not in suites()
        if own and str(error).startswith(("Unknown method ", "Unknown operator ")):
            raise field_error("Suite", Path(suite), (chosen.ranks,), error) from error
        raise


def _show_run(result: "RunResult", as_json: bool, limit: int | None) -> None:
    from eitbench.benchmark.analysis.results import failures_with_traces, read_run
    from eitbench.benchmark.rundir import manifest
    from eitbench.reports.tables.terminal import table
    from eitbench.scenarios.errors import counted

    for name, data in manifest.read(result.path)["data"].items():
        if limit is not None and data["n"] < limit:
            warn(
                f"Scenario {name!r} has only {counted(data['n'], 'test sample')}, fewer than "
                f"--limit {limit}: all are used."
            )
    rows, figures = _complete(result.path)
    if as_json:
        print_json(
            {
                "run": str(result.path),
                "leaderboard": rows,
                "figures": [str(path) for path in figures],
                "skipped": list(result.skipped),
                "refused": list(result.refused),
                "unfinished": result.unfinished,
            }
        )
        return
    print_renderable(table(rows, width()))
    for sentence in (*result.skipped, *result.refused):
        typer.echo(sentence)
    for sentence, trace in failures_with_traces(read_run(result.path)):
        typer.echo("\n".join([sentence, *trace.splitlines()]))
    if result.unfinished:
        typer.echo(result.unfinished)
    typer.echo(f"Run: {result.path}")
    for path in figures:
        if path.suffix in (".png", ".md"):
            typer.echo(f"{'Picture' if path.suffix == '.png' else 'Table'}: {path}")


def all_failed(run: Path) -> bool:
    """True for a run that has samples, none of them with an image or voltages."""
    from eitbench.benchmark.analysis.results import read_run

    samples = read_run(run).samples
    return not samples.empty and not (samples["status"] == "ok").any()


def _complete(run: Path) -> tuple[list[dict[str, Any]], list[Path]]:
    """Write notes, leaderboard and figures into a run directory; its rows and the pictures."""
    from eitbench.benchmark.analysis.recording_notes import write_notes
    from eitbench.reports.figures.image_grid import write_figures
    from eitbench.reports.figures.voltages import write_voltages
    from eitbench.reports.findings.collect import write_findings
    from eitbench.reports.tables.leaderboard import ranked_rows, write_leaderboard

    write_notes(run)
    rows = ranked_rows([run])
    write_leaderboard(rows, run)
    drawn = [write(run) for write in (write_findings, write_figures, write_voltages)]
    return rows, [path for written in drawn for path in written]


@app.command(epilog="Example: eitbench reproduce --limit 200 --out runs/claims")
def reproduce(
    runs: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Run nothing: use this run directory (repeatable)."),
    ] = None,
    study: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Use this study, too (repeatable)."),
    ] = None,
    limit: Limit = None,
    jobs: Jobs = 1,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of all results; runs that are in it are not run again."
        ),
    ] = None,
) -> None:
    """Compare the published claims with own measurements, and write the claim ledger."""
    from eitbench.benchmark.run.progress import RunProgress
    from eitbench.benchmark.studies.reproduce import run_claims
    from eitbench.benchmark.studies.training_study import paper_curves
    from eitbench.reports.claims.ledger import claim_ledger, table
    from eitbench.reports.page.ledger_page import write_ledger
    from eitbench.scenarios.errors import InputError

    if runs and limit is not None:
        raise typer.BadParameter("--runs are used as they are: leave out --limit")
    folder = out or new_folder("reproduce")
    if not runs:
        runs = run_claims(folder, limit=limit, jobs=jobs, progress=RunProgress())
        for path in runs:
            _complete(path)
    try:
        curves = paper_curves()
    except InputError:
        curves = None  # one of the networks has no weights
    ledger = claim_ledger(runs, study or (), curves)
    written = write_ledger(ledger, runs, folder, curves)
    print_renderable(table(ledger))
    for path in written:
        typer.echo(f"Ledger: {path}")


@app.command(epilog="Example: eitbench rescore runs/first")
def rescore(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory; changed in place.")],
) -> None:
    """Compute all metrics again from the stored reconstructions, without running a method."""
    from eitbench.benchmark.analysis.rescore import rescore as score_again
    from eitbench.scenarios.errors import counted

    cells = score_again(run)
    for cell in cells:
        if cell.changed:
            figures = ", ".join(cell.figures)
            typer.echo(
                f"{cell.scenario}  {cell.method}  {cell.changed} of {cell.n} changed: {figures}"
            )
    _complete(run)
    changed, total = sum(cell.changed for cell in cells), sum(cell.n for cell in cells)
    typer.echo(f"Scored again: {counted(total, 'sample')}, of which {changed} changed.")
