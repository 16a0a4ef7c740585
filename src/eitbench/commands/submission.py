"""Commands of submissions to the leaderboard."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eitbench.commands.console import fail, print_check
from eitbench.commands.runs import Isolate

if TYPE_CHECKING:
    from eitbench.benchmark.submissions.submission import Submission

app = typer.Typer(
    help="Runs for the public leaderboard.",
    epilog="Example: eitbench submission make runs/mine --out submission",
    no_args_is_help=True,
)
Simulating = Annotated[int, typer.Option(min=1, help="Processes to simulate with.")]


@app.command("make", epilog="Example: eitbench submission make runs/mine --out submission")
def make(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A finished run of a whole suite.")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="New folder; its name is that of the submission.")
    ],
    jobs: Simulating = 1,
) -> None:
    """Write a run as a folder for a pull request; what `check` refuses is refused here.

    Images are rounded to 1/1024 of their largest contrast or finer, where that moves no figure that
    ranks a method by more than 0.001 or, of a length, 0.1 mm.
    """
    from eitbench.benchmark.submissions.statement import STATEMENT
    from eitbench.reports.board.submissions import write_submission

    arrays = run / "reconstructions.h5"
    if arrays.is_file():
        typer.echo(f"{run} has {arrays.stat().st_size / 1e6:.1f} MB of images.")
    written = write_submission(run, out, jobs=jobs)
    if written.moved:
        typer.echo(f"Images stay as they are: rounding moves {written.moved}.")
    typer.echo(f"Submission: {out}, {written.size / 1e6:.1f} MB")
    typer.echo(
        f"Fill in {out / STATEMENT}, then: eitbench submission check {shlex.quote(str(out))}"
    )


@app.command("check", epilog="Example: eitbench submission check submission --jobs 2")
def check(
    run: Annotated[
        Path, typer.Argument(metavar="DIR", help="A submission, or a run that is to be one.")
    ],
    jobs: Simulating = 1,
    rerun: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Run the methods again, plugins too, on N samples."),
    ] = None,
    isolate: Isolate = False,
) -> None:
    """Check that a run is complete, on our data, and has the figures of its images.

    Nothing that it holds is run or unpickled, unless --rerun asks for its plugins to be run.
    """
    from eitbench.benchmark.submissions.check import check_submission
    from eitbench.benchmark.submissions.rerun import (
        LEAST_REPRODUCED,
        note_reproduced,
        withdraw_reproduced,
    )
    from eitbench.benchmark.submissions.rerun import rerun as run_again
    from eitbench.benchmark.submissions.statement import STATEMENT
    from eitbench.benchmark.submissions.submission import STATED, TRUST, open_submission
    from eitbench.benchmark.submissions.tiers import reproduced_on

    submission = open_submission(run, jobs=jobs)
    checks = check_submission(submission)
    acceptable = not any(check_of.problem for check_of in checks)
    # A plugin is code of somebody else: it runs only where all that can be read is right.
    if rerun is not None and acceptable:
        again = run_again(submission, rerun, isolate=isolate)
        if refuted := any(check_of.refutes for check_of in again):
            withdraw_reproduced(run)
        acceptable = not refuted
        checks += again
    for check_of in checks:
        print_check("failed" if check_of.problem else "passed", check_of.name, check_of.problem)
    if not acceptable:
        fail(f"{run} cannot be accepted as a submission.", 1)
    if any(check_of.problem for check_of in checks):
        fail(f"{run} could not be run again here: its tier stays as it was.", 1)
    _print_trust(submission)
    if rerun is None:
        if told := reproduced_on(submission.run):
            typer.echo(f"Taken on trust: {'; '.join(STATED)}. Run again before: {told}.")
        else:
            typer.echo(f"Taken on trust: {'; '.join(TRUST)}. --rerun N runs the methods again.")
        typer.echo(f"Tier: {'reproduced' if told else 'self-reported'}")
    else:
        typer.echo(f"Taken on trust: {'; '.join(STATED)}.")
        if not isolate:
            typer.echo("Not noted: without --isolate a method may read images, and not make them.")
        elif noted := note_reproduced(submission, rerun):
            typer.echo(f"Noted in {noted}")
        else:
            typer.echo(
                f"So few samples are not noted: --rerun {LEAST_REPRODUCED} makes it reproduced."
            )
        typer.echo(f"Tier: {'reproduced' if reproduced_on(submission.run) else 'self-reported'}")
    if (run / STATEMENT).is_file():
        typer.echo(f"{run} can be submitted.")
    else:
        make = f"eitbench submission make {shlex.quote(str(run))} --out NAME"
        typer.echo(f"{run} can be submitted: `{make}`.")


def _print_trust(submission: "Submission") -> None:
    """Print the times, and the methods whose training data nobody can look up here."""
    from eitbench.benchmark.analysis.leaderboard import leaderboard_rows
    from eitbench.benchmark.submissions.submission import unknown_training

    for row in leaderboard_rows([submission.run]):
        frame, solves = row["frame_ms_p50"], row["frame_solves"]
        if frame is not None:
            solve = "" if solves is None else f", {solves:.3g} calibration solves"
            typer.echo(
                f"Time (self-reported): {row['method']!r} on {row['scenario']!r}, "
                f"{frame:.3g} ms a frame{solve}"
            )
    for cell in unknown_training(submission):
        typer.echo(f"Stated, not checked: {cell} was trained on data that are not known here.")
