"""Commands that deal with recorded sensor sets, public and own."""

from pathlib import Path
from typing import Annotated

import typer

from eitbench.commands.console import fail

app = typer.Typer(
    help="Recorded sensor sets, public and own.",
    epilog="Example: eitbench recordings fetch ohmc16",
    no_args_is_help=True,
)


@app.command(epilog="Example: eitbench recordings fetch ohmc16")
def fetch(
    name: Annotated[str, typer.Argument(help="A recorded set (eitbench list recordings).")],
) -> None:
    """Find or download a recorded set and verify it."""
    from eitbench.scenarios.recordings import recorded_set
    from eitbench.scenarios.recordings.fetch import fetch_recording

    typer.echo(f"{name} is in {fetch_recording(recorded_set(name), progress=True)}")


@app.command(epilog="Example: eitbench recordings check touch.h5")
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE.h5", help="A recording of your own.")],
    sensor: Annotated[
        str | None,
        typer.Option(help="Another sensor, or a sensor file: does its model fit better?"),
    ] = None,
) -> None:
    """Say what a recording holds and what is wrong with it; exits 1 if anything is."""
    from eitbench.scenarios.catalogue import sensor as sensor_by_name
    from eitbench.scenarios.recordings.quality import check as check_recording

    other = None if sensor is None else sensor_by_name(sensor)
    problems, facts = check_recording(file, other)
    for sentence in (*facts, *problems):
        typer.echo(sentence)
    if problems:
        fail(f"{file} has {len(problems)} problem{'s' if len(problems) > 1 else ''}.", 1)
    typer.echo(f"{file} is sound.")


@app.command(epilog="Example: eitbench recordings export touch.h5 --to touch.csv")
def export(
    file: Annotated[Path, typer.Argument(metavar="FILE.h5", help="A recording of your own.")],
    to: Annotated[Path, typer.Option(metavar="FILE", help="A new .csv, .mat or .h5 file.")],
) -> None:
    """Write a recording to another file; .h5 makes a cut-off one whole; refuses a damaged one."""
    from eitbench.hardware.recording.exchange import export_recording

    typer.echo(export_recording(file, to))


@app.command("import", epilog="Example: eitbench recordings import ohmc16 --out ohmc16.h5")
def import_command(
    source: Annotated[str, typer.Argument(help="A .csv or .mat file, or a public recorded set.")],
    out: Annotated[Path, typer.Option(metavar="FILE.h5", help="The new recording.")],
    sensor: Annotated[
        str | None,
        typer.Option(help="What was measured, or a sensor file, .toml, if SOURCE does not say."),
    ] = None,
) -> None:
    """Make a recording of a CSV or MATLAB file, or of a public recorded set."""
    from eitbench.hardware.recording.exchange import import_recording
    from eitbench.scenarios.catalogue import sensor as sensor_by_name

    nominal = None if sensor is None else sensor_by_name(sensor)
    typer.echo(f"{import_recording(source, out, nominal)} frames are in {out}.")
