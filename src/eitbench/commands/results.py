"""Commands that show and compare stored results."""

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eitbench.commands.console import Json, names_in, print_json, print_renderable, warn, width
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from eitbench.benchmark.analysis.comparison import RunComparison

app = typer.Typer()


Format = StrEnum("Format", ["md", "csv", "json", "latex", "html"])


@app.command(epilog="Example: eitbench leaderboard runs/first --format latex > table.tex")
def leaderboard(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run directories.")],
    form: Annotated[
        Format | None, typer.Option("--format", help="Print for a file, not for a terminal.")
    ] = None,
    columns: Annotated[
        str | None, typer.Option(metavar="A,B", help="Show these columns, such as score,ssim.")
    ] = None,
    sort: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Best first by this column, not by rank.")
    ] = None,
) -> None:
    """Print the leaderboard of one or several runs."""
    from eitbench.reports.tables import leaderboard as reports
    from eitbench.reports.tables.terminal import table

    names = names_in("--columns", columns)
    rows = reports.ranked_rows(runs, [*names, *([sort] if sort else [])])
    if not rows:
        raise InputError(
            f"There are no rows in {', '.join(map(str, runs))}: nothing was finished there; "
            "`eitbench run --resume` continues a run."
        )
    chosen = reports.chosen_columns(rows, names) if names else []
    if sort is not None:
        rows = reports.sorted_rows(rows, sort)
    if form is None:
        print_renderable(table(rows, width(), chosen))
    else:
        typer.echo(reports.FORMATS[form.value](rows, chosen), nl=False)


@app.command(epilog="Example: eitbench report runs/first runs/second --out report")
def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run directories.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Its folder (default: RUN/report).")
    ] = None,
) -> None:
    """Write a report of runs: one HTML page that works offline, tables and figures for a paper."""
    from eitbench.benchmark.rundir import manifest
    from eitbench.reports.page.report import write_report

    if out is None:
        manifest.check_own(runs[0], manifest.read(runs[0]), "name a folder with --out")
    written, missing = write_report(runs, out or runs[0] / "report")
    for path in written:
        typer.echo(str(path))
    for sentence in missing:
        warn(sentence)


@app.command(epilog="Example: eitbench site runs --out site")
def site(
    runs: Annotated[Path, typer.Argument(metavar="RUNS_DIR", help="A folder of run directories.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Its folder.")],
) -> None:
    """Build a static leaderboard from many runs: one page a suite, one a method, all versions."""
    from eitbench.reports.site.site import write_site

    written = write_site(runs, out, progress=True)
    typer.echo(f"Site: {written.pages[0]} ({len(written.pages)} pages)")
    for why in written.left_out:
        warn(f"{why}.")


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
    """Say what changed between two runs, and whether it matters: by the same test as `gate`."""
    from eitbench.benchmark.analysis.comparison import compare as compared
    from eitbench.benchmark.analysis.comparison import read_results

    margins = dict.fromkeys(names_in("--figures", figures), 0.0)
    found = compared(read_results(before), read_results(after), margins)
    if as_json:
        print_json(asdict(found))
        return
    _print_changes(found)


@app.command(epilog="Example: eitbench gate runs/new --baseline main.parquet --margin score=0.05")
def gate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run to check.")],
    baseline: Annotated[
        Path, typer.Option(metavar="FILE", help="A run directory, or the samples.parquet of one.")
    ],
    margin: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIGURE=LOSS",
            help="How much of a figure may be lost (repeatable; default: nothing of what each "
            "scenario is ranked by).",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Exit with 1 if a method of the baseline is missing, or worse by more than a margin.

    The test is that of `compare`. What has too few samples for it does not pass.
    """
    from eitbench.benchmark.analysis.comparison import TOO_FEW, figure_called, read_results
    from eitbench.benchmark.analysis.comparison import compare as compared

    margins: dict[str, float] = {}
    for text, allowed in map(_margin, margin or ()):
        name = figure_called(text)
        if name in margins:
            raise typer.BadParameter(f"--margin names {name!r} twice")
        margins[name] = allowed
    found = compared(read_results(baseline), read_results(run), margins)
    verdicts = [change.verdict for change in found.changes]
    lost, untested = verdicts.count("worse"), verdicts.count(TOO_FEW)
    passed = not (lost or untested or found.missing)
    if as_json:
        print_json({"passed": passed, **asdict(found)})
    else:
        _print_changes(found)
        typer.echo(
            f"Gate {'passed' if passed else 'failed'}: {lost} of {len(found.changes)} figures "
            f"are significantly worse by more than is allowed; {untested} could not be tested; "
            f"{'what is missing is named above' if found.missing else 'nothing is missing'}."
        )
    if not passed:
        raise typer.Exit(1)


def _print_changes(found: "RunComparison") -> None:
    from eitbench.commands.tables import changes_notes, changes_table

    print_renderable(changes_table(found))
    for sentence in (*changes_notes(found), *found.missing, *found.added, *found.busy):
        typer.echo(sentence)


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
