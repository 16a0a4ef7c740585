"""The command line: reads arguments, calls the rooms, prints; it decides nothing by itself.

Libraries that take long to import are imported by the command that needs them, so that
`eitbench --help` answers at once.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from eitbench.benchmark.checking import CheckReport
    from eitbench.benchmark.runner import Plan, RunResult

app = typer.Typer(
    help="The benchmark for electrical impedance tomography (EIT) tactile sensing.",
    epilog="Example: eitbench run quick",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
recordings_app = typer.Typer(
    help="Recorded sensor sets.",
    epilog="Example: eitbench recordings fetch ohmc16",
    no_args_is_help=True,
)
app.add_typer(recordings_app, name="recordings")
submission_app = typer.Typer(
    help="Runs for a public leaderboard.",
    epilog="Example: eitbench submission check runs/mine",
    no_args_is_help=True,
)
app.add_typer(submission_app, name="submission")

Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]


class Listing(StrEnum):
    """What can be listed."""

    methods = "methods"
    operators = "operators"
    scenarios = "scenarios"
    sensors = "sensors"
    suites = "suites"
    recordings = "recordings"


class Format(StrEnum):
    """How a leaderboard can be printed."""

    md = "md"
    csv = "csv"
    json = "json"
    latex = "latex"
    html = "html"


def _version(asked: bool) -> None:
    if asked:
        from eitbench import __version__

        typer.echo(f"eitbench {__version__}")
        raise typer.Exit


@app.callback()
def _main_options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="On an error, print the traceback too.")
    ] = False,
) -> None:
    pass


@app.command("list", epilog="Example: eitbench list methods")
def list_command(
    what: Annotated[Listing, typer.Argument(help="What to list.")],
    as_json: Json = False,
) -> None:
    """List methods, operators, scenarios, sensors, suites or recordings."""
    from eitbench.benchmark.listing import LISTINGS

    rows = LISTINGS[what.value]()
    if as_json:
        _print_json(rows)
    else:
        from eitbench.reports.listing import names_table

        _print_renderable(names_table(rows))


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
        str | None, typer.Option(metavar="X,Y", help="Run these scenarios only.")
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Test samples of each scenario.")] = None,
    plugin: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE.py", help="A file with more methods or operators."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Cells (scenario x method) at a time.")] = 1,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder (default: runs/SUITE-TIME).")
    ] = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Continue the run in DIR, in place.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a suite and print its leaderboard."""
    from eitbench.benchmark.progress import RunProgress
    from eitbench.benchmark.runner import RunInterruptedError, resume_run, start_run
    from eitbench.scenarios.suites import load_suite

    choices = (methods, operators, scenarios, limit, plugin or None, out)
    if resume is not None and any(choice is not None for choice in choices):
        raise typer.BadParameter("a resumed run keeps its choices: give SUITE and --jobs only")
    if resume is None and suite is None:
        raise typer.BadParameter("name a suite (eitbench list suites), or give --resume DIR")
    progress = RunProgress()
    try:
        if resume is not None:
            chosen = None if suite is None else load_suite(suite)
            result = resume_run(resume, suite=chosen, jobs=jobs, progress=progress)
        elif suite is not None:
            plan = _plan(suite, methods, scenarios, limit, plugin, operators)
            folder = out or Path("runs") / f"{plan.suite.name}-{time.strftime('%Y%m%d-%H%M%S')}"
            result = start_run(plan, folder, jobs=jobs, progress=progress)
    except RunInterruptedError as interrupted:
        _fail(str(interrupted), 130)
    _show_run(result, as_json, limit)
    if result.refused:
        raise typer.Exit(1)


def _plan(
    suite: str,
    methods: str | None,
    scenarios: str | None,
    limit: int | None,
    plugins: Sequence[Path] | None,
    operators: str | None = None,
) -> "Plan":
    from eitbench.benchmark.runner import make_plan
    from eitbench.scenarios.errors import InputError
    from eitbench.scenarios.suites import declared_at, load_suite, suites

    chosen = load_suite(suite)
    try:
        return make_plan(
            chosen,
            methods=_names("--methods", methods),
            operators=_names("--operators", operators),
            scenarios=_names("--scenarios", scenarios),
            limit=limit,
            plugins=plugins or (),
        )
    except InputError as error:
        # What it ranks is unknown to scenarios, so that only here a suite's own can be wrong.
        own = methods is None and operators is None and suite not in suites()
        if own and str(error).startswith(("Unknown method ", "Unknown operator ")):
            raise InputError(f"{declared_at(Path(suite), chosen.ranks)}: {error}") from error
        raise


def _show_run(result: "RunResult", as_json: bool, limit: int | None) -> None:
    from eitbench.benchmark import manifest
    from eitbench.benchmark.results import failures, read_run
    from eitbench.reports.leaderboard import table

    for name, data in manifest.read(result.path)["data"].items():
        if limit is not None and data["n"] < limit:
            _warn(f"Scenario {name!r} has only {data['n']} test samples: --limit {limit} is above.")
    rows, figures = _complete(result.path)
    if as_json:
        _print_json(
            {
                "run": str(result.path),
                "leaderboard": rows,
                "figures": [str(path) for path in figures],
                "skipped": list(result.skipped),
                "refused": list(result.refused),
            }
        )
        return
    _print_renderable(table(rows, _width()))
    for sentence in (*result.skipped, *result.refused, *failures(read_run(result.path))):
        typer.echo(sentence)
    typer.echo(f"Run: {result.path}")
    for path in figures:
        if path.suffix == ".png":
            typer.echo(f"Picture: {path}")


def _complete(run: Path) -> tuple[list[dict[str, Any]], list[Path]]:
    """Write notes, leaderboard and figures into a run directory; its rows and the pictures."""
    from eitbench.benchmark.recorded import write_notes
    from eitbench.reports.figures import write_figures
    from eitbench.reports.leaderboard import leaderboard, write_leaderboard

    write_notes(run)
    rows = leaderboard([run])
    write_leaderboard(rows, run)
    return rows, write_figures(run)


@app.command(epilog="Example: eitbench reproduce --limit 200 --out runs/claims")
def reproduce(
    runs: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Run nothing: judge by this run directory (repeatable)."),
    ] = None,
    study: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Judge by this study, too (repeatable)."),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Test samples of each scenario.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Cells (scenario x method) at a time.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where all goes; what is run there is not run again."),
    ] = None,
) -> None:
    """Judge the published claims by what is measured here, and write the claim ledger."""
    from eitbench.benchmark.progress import RunProgress
    from eitbench.benchmark.reproduce import run_claims
    from eitbench.benchmark.runner import RunInterruptedError
    from eitbench.reports.ledger import ledger, table, write_ledger

    if runs and limit is not None:
        raise typer.BadParameter("--runs are judged as they are: leave out --limit")
    folder = out or Path("runs") / f"reproduce-{time.strftime('%Y%m%d-%H%M%S')}"
    if not runs:
        try:
            runs = run_claims(folder, limit=limit, jobs=jobs, progress=RunProgress())
        except RunInterruptedError as interrupted:
            _fail(str(interrupted), 130)
        for path in runs:
            _complete(path)
    found = ledger(runs, study or ())
    written = write_ledger(found, runs, folder)
    _print_renderable(table(found))
    for path in written:
        typer.echo(f"Ledger: {path}")


@app.command(epilog="Example: eitbench leaderboard runs/first --format latex > table.tex")
def leaderboard(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run directories.")],
    form: Annotated[
        Format | None, typer.Option("--format", help="Print for a file, not for a terminal.")
    ] = None,
) -> None:
    """Print the leaderboard of one or several runs."""
    from eitbench.reports import leaderboard as reports

    rows = reports.leaderboard(runs)
    if not rows:
        _warn(f"There are no rows in {', '.join(map(str, runs))}: nothing was finished there.")
    if form is None:
        _print_renderable(reports.table(rows, _width()))
    else:
        typer.echo(reports.FORMATS[form.value](rows), nl=False)


@app.command(epilog="Example: eitbench report runs/first runs/second --out report")
def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run directories.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Its folder (default: RUN/report).")
    ] = None,
) -> None:
    """Write a report of runs: one HTML page that works offline, tables and figures for a paper."""
    from eitbench.reports.report import write_report

    for path in write_report(runs, out or runs[0] / "report"):
        typer.echo(str(path))


@app.command(epilog="Example: eitbench site runs --out site")
def site(
    runs: Annotated[Path, typer.Argument(metavar="RUNS_DIR", help="A folder of run directories.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Its folder.")],
) -> None:
    """Build a static leaderboard from many runs: one page a suite, one a method, all versions."""
    from eitbench.reports.site import write_site

    written = write_site(runs, out)
    typer.echo(f"Site: {written[0]} and {len(written) - 1} more pages")


@app.command(epilog="Example: eitbench compare runs/before runs/after --figures ssim,psnr")
def compare(
    before: Annotated[Path, typer.Argument(metavar="RUN_A", help="A run, or its samples.parquet.")],
    after: Annotated[Path, typer.Argument(metavar="RUN_B", help="A later run on the same frames.")],
    figures: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Compare these (default: what each scenario ranks by)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what changed between two runs, and whether it matters."""
    from eitbench.benchmark.comparison import compare as compared
    from eitbench.benchmark.comparison import read_results
    from eitbench.reports.changes import describe, table

    found = compared(read_results(before), read_results(after), _names("--figures", figures))
    if as_json:
        _print_json(describe(found))
        return
    _print_renderable(table(found))
    for sentence in (*found.missing, *found.added):
        typer.echo(sentence)


@app.command(epilog="Example: eitbench gate runs/new --baseline main.parquet --margin score=0.05")
def gate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run to judge.")],
    baseline: Annotated[
        Path, typer.Option(metavar="FILE", help="A run directory, or the samples.parquet of one.")
    ],
    margin: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIGURE=LOSS",
            help="A loss that is allowed (repeatable; default: none of what each scenario ranks "
            "by).",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Exit with 1 if a method of the baseline is missing or surely worse by more than a margin."""
    from eitbench.benchmark.comparison import losses, read_results
    from eitbench.reports.changes import describe, table

    margins: dict[str, float] = {}
    for name, allowed in map(_margin, margin or ()):
        if name in margins:
            raise typer.BadParameter(f"--margin names {name!r} twice")
        margins[name] = allowed
    found = losses(read_results(baseline), read_results(run), margins)
    lost = [change for change in found.changes if change.verdict == "worse"]
    passed = not lost and not found.missing
    if as_json:
        _print_json({"passed": passed, **describe(found)})
    else:
        _print_renderable(table(found))
        for sentence in (*found.missing, *found.added):
            typer.echo(sentence)
        typer.echo(
            f"Gate {'passed' if passed else 'failed'}: {len(lost)} of {len(found.changes)} figures "
            f"are surely worse by more than is allowed; {len(found.missing)} things missing."
        )
    if not passed:
        raise typer.Exit(1)


def _margin(text: str) -> tuple[str, float]:
    name, _, loss = text.partition("=")
    try:
        allowed = float(loss)
    except ValueError:
        allowed = -1.0
    if not allowed >= 0:
        raise typer.BadParameter(
            f"--margin {text!r} is not FIGURE=LOSS with a loss of at least 0, such as score=0.05"
        )
    return name, allowed


@app.command(epilog="Example: eitbench rescore runs/first")
def rescore(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory; changed in place.")],
) -> None:
    """Compute all metrics again from the stored reconstructions, without running a method."""
    from eitbench.benchmark.rescore import rescore as score_again

    cells = score_again(run)
    for cell in cells:
        if cell.changed:
            figures = ", ".join(cell.figures)
            typer.echo(
                f"{cell.scenario}  {cell.method}  {cell.changed} of {cell.n} changed: {figures}"
            )
    _complete(run)
    changed, total = sum(cell.changed for cell in cells), sum(cell.n for cell in cells)
    typer.echo(f"Scored again: {total} samples, of which {changed} changed.")


@app.command(epilog="Example: eitbench tune quick --methods noser,tv --jobs 2")
def tune(
    suite: Annotated[str, typer.Argument(help="A suite's name, or the path of a suite file.")],
    methods: Annotated[
        str | None, typer.Option(metavar="A,B", help="Tune these methods only.")
    ] = None,
    scenarios: Annotated[
        str | None, typer.Option(metavar="X,Y", help="On these scenarios only.")
    ] = None,
    plugin: Annotated[
        list[Path] | None, typer.Option(metavar="FILE.py", help="A file with more methods.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Methods at a time.")] = 1,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where choices go (default: your cache).")
    ] = None,
) -> None:
    """Choose hyper-parameters on the validation split; later runs use them (track `tuned`)."""
    from eitbench.benchmark.selection import tune as choose_all
    from eitbench.benchmark.selection import user_choices

    plan = _plan(suite, methods, scenarios, None, plugin)
    chosen = [s for s in plan.suite.scenarios if s.name in plan.scenarios]
    folder = out or user_choices()
    files = [path for path, _ in plan.plugins]
    for scenario, name, choice in choose_all(
        chosen, plan.methods, folder, plugins=files, jobs=jobs
    ):
        typer.echo(f"{scenario}  {name}  {json.dumps(choice.parameters)}")
    typer.echo(f"Choices: {folder}")


@app.command(epilog="Example: eitbench train dnn --suite paper --jobs 2")
def train(
    name: Annotated[
        str,
        typer.Argument(help="What to train: dnn, phydnn, coarse-to-fine, learned-gn or surrogate."),
    ],
    suite: Annotated[
        str, typer.Option(help="The suite with the data: its name, or the path of its file.")
    ],
    epochs: Annotated[
        int | None, typer.Option(min=1, help="Passes over the training data (default: its own).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Decides all that is random.")] = 0,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Use so many training samples (default: all).")
    ] = None,
    operator: Annotated[
        str, typer.Option(help="Forward operator of the physical loss.")
    ] = "surrogate",
    beta: Annotated[
        float | None, typer.Option(help="Weight of the physical loss (default: as published).")
    ] = None,
    backbone: Annotated[
        str, typer.Option(help="Kind of network: unet, unet-small or mlp.")
    ] = "unet",
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    devices: Annotated[
        int, typer.Option(min=1, help="Devices of that kind, which share each batch.")
    ] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="Processes to simulate with.")] = 1,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where it is kept (default: your cache).")
    ] = None,
) -> None:
    """Train on a suite's data, or continue a training that was stopped."""
    from eitbench.methods.training import Devices, Request, TrainingInterruptedError
    from eitbench.methods.training import train as train_named

    try:
        result = train_named(
            Request(
                name,
                suite,
                epochs=epochs,
                seed=seed,
                limit=limit,
                operator=operator,
                beta=beta,
                backbone=backbone,
                devices=Devices(device, devices),
                jobs=jobs,
                out=out,
                progress=True,
            )
        )
    except TrainingInterruptedError as interrupted:
        _fail(str(interrupted), 130)
    for sentence in result.sentences():
        typer.echo(sentence)


@app.command(
    epilog="Example: eitbench study beta --epochs 12 --limit 1500 --jobs 2 --out runs/beta"
)
def study(
    name: Annotated[str, typer.Argument(help="beta, physics or size.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where it is kept, and continued.")],
    suite: Annotated[str, typer.Option(help="The suite with the data.")] = "paper",
    epochs: Annotated[int | None, typer.Option(min=1, help="Of each training.")] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Training samples of each (default: all).")
    ] = None,
    judged: Annotated[
        int | None, typer.Option(min=2, help="Samples it is judged on (default: all).")
    ] = None,
    operator: Annotated[
        str, typer.Option(help="Forward operator of the physical loss.")
    ] = "surrogate",
    jobs: Annotated[int, typer.Option(min=1, help="Trainings at a time.")] = 1,
) -> None:
    """Train many networks that differ in one thing, or continue, and say what it is worth."""
    from eitbench.benchmark.study import Budget, run_study
    from eitbench.reports.study import write_study

    budget = Budget(suite, epochs, limit, judged, operator)
    run_study(name, budget, out, jobs=jobs, progress=True)
    for path in write_study(out):
        typer.echo(str(path))


@app.command("real-trained", epilog="Example: eitbench real-trained --jobs 2 --out runs/presses")
def real_trained_command(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the errors and figure go.")],
    recording: Annotated[
        str, typer.Argument(help="A recorded set that knows where it was pressed.")
    ] = "ohmc16",
    jobs: Annotated[int, typer.Option(min=1, help="Folds at a time.")] = 1,
) -> None:
    """Measure how far presses are placed wrong after learning from 0 to 400 real ones."""
    from eitbench.benchmark.real_trained import real_trained
    from eitbench.reports.real_trained import summary, to_markdown, write_real_trained

    errors = real_trained(recording, jobs=jobs)
    typer.echo(f"Median error [mm] on {recording}, cross-validated:\n")
    typer.echo(to_markdown(summary(errors)))
    for path in write_real_trained(errors, recording, out):
        typer.echo(str(path))


@app.command(epilog="Example: eitbench check noser, or: eitbench check my_operator.py")
def check(
    target: Annotated[
        str, typer.Argument(metavar="METHOD|OPERATOR|FILE.py", help="What to check.")
    ],
    as_json: Json = False,
) -> None:
    """Check that a method or operator keeps the contract; exits 1 if any check fails."""
    from eitbench.benchmark.checks import check_target

    reports = check_target(target)
    if as_json:
        _print_json([report.describe() for report in reports])
    else:
        for report in reports:
            _print_check(report)
    if not all(report.passed for report in reports):
        raise typer.Exit(1)


def _print_check(report: "CheckReport") -> None:
    for result in report.results:
        status = "FAILED" if result.status == "failed" else result.status
        typer.echo(f"{status:7s}  {result.name}")
        if result.message:
            typer.echo(f"         {result.message}")
    typer.echo(report.summary())


@app.command("new-method", epilog="Example: eitbench new-method my-method")
def new_method_command(
    name: Annotated[str, typer.Argument(help="Small letters, digits and hyphens.")],
    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="New folder (default: eitbench-NAME).")
    ] = None,
) -> None:
    """Write an installable package around a method that works, to put yours in its place."""
    from eitbench.benchmark.scaffold import new_method

    written = new_method(name, folder)
    for path in written:
        typer.echo(str(path))
    typer.echo(f"Next: pip install -e {written[0].parent} && eitbench check {name}")


@recordings_app.command(epilog="Example: eitbench recordings fetch ohmc16")
def fetch(
    name: Annotated[str, typer.Argument(help="A recorded set (eitbench list recordings).")],
) -> None:
    """Find or download a recorded set and verify it."""
    from eitbench.scenarios.recordings import recorded_set
    from eitbench.scenarios.recordings.fetch import intact

    typer.echo(f"{name} is in {intact(recorded_set(name), progress=True)}")


@submission_app.command("check", epilog="Example: eitbench submission check runs/mine --jobs 2")
def submission_check(
    run: Annotated[Path, typer.Argument(metavar="DIR", help="A run directory.")],
    jobs: Annotated[int, typer.Option(min=1, help="Processes to simulate with.")] = 1,
) -> None:
    """Check that a run is complete, on our data, and has the figures of its images."""
    from eitbench.benchmark.submission import check_submission

    checks = check_submission(run, jobs=jobs)
    for check_of in checks:
        typer.echo(f"{'FAILED' if check_of.problem else 'passed':7s}  {check_of.name}")
        if check_of.problem:
            typer.echo(f"         {check_of.problem}")
    if any(check_of.problem for check_of in checks):
        _fail(f"{run} cannot be accepted as a submission.", 1)
    typer.echo(f"{run} can be submitted.")


def _names(option: str, text: str | None) -> Sequence[str]:
    """The names in `text`; none where the option was not given."""
    names = [name.strip() for name in (text or "").split(",") if name.strip()]
    if text is not None and not names:
        raise typer.BadParameter(f"{option} names nothing: give names with commas between them")
    return names


def _print_json(value: Any) -> None:
    typer.echo(json.dumps(value, indent=2, allow_nan=False, default=str))


def _print_renderable(renderable: Any) -> None:
    from rich.console import Console

    Console(width=_width(), highlight=False).print(renderable)


def _width() -> int:
    """Characters in a line; without a terminal nothing is folded, so that grep works."""
    import shutil

    return shutil.get_terminal_size().columns if sys.stdout.isatty() else 400


def main() -> None:
    """Run the command line; every error becomes one sentence and an exit code."""
    debug = "--debug" in sys.argv[1:]
    # Accepted anywhere, since it is added to a command that has just failed.
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    code = _guarded(lambda: app(args=arguments, prog_name="eitbench", standalone_mode=False), debug)
    sys.exit(code)


# Typer raises these of click's, or of its own copy of click, which has no public name.
_UsageError = typer.BadParameter.__mro__[1]


def _guarded(command: Callable[[], object], debug: bool) -> int:
    """The exit code of `command`."""
    try:
        code = command()
    except typer.Abort:
        code = 130
    except BrokenPipeError:
        # The reader (head, less) has seen enough; nothing may be flushed to it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except KeyboardInterrupt:
        _fail("Interrupted.", 130)
    except Exception as error:
        if isinstance(error, _UsageError):
            _fail_usage(error)
        if debug:
            raise
        from eitbench.scenarios.errors import EitbenchError, InputError

        if isinstance(error, EitbenchError):
            _fail(str(error), 2 if isinstance(error, InputError) else 1)
        if isinstance(error, OSError) and error.filename is not None:
            _fail(f"Could not use {error.filename}: {error.strerror}.", 1)
        _fail(
            f"Unexpected {type(error).__name__}: {error}. Add --debug for the traceback, and "
            "please report it.",
            1,
        )
    if code == 130:
        _fail("Interrupted.", 130)
    return code if isinstance(code, int) else 0


def _fail_usage(error: Any) -> NoReturn:
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        sys.exit(2)
    sentence = str(error.format_message()).removeprefix("Invalid value: ").rstrip(".")
    command = error.ctx.command_path if error.ctx is not None else "eitbench"
    _fail(f"{sentence[:1].upper()}{sentence[1:]}; see `{command} --help`.", 2)


def _fail(sentence: str, code: int) -> NoReturn:
    _warn(sentence)
    sys.exit(code)


def _warn(sentence: str) -> None:
    typer.echo(f"eitbench: {' '.join(sentence.split())}", err=True)


if __name__ == "__main__":
    main()
