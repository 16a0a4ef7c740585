"""Commands that deal with recorded sensor sets, public and own."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from eitbench.commands.console import fail, new_folder

# As in hardware/recording/importing/arrays.py, which takes time to import.
Order = Literal["rows", "columns"]
Part = Literal["real", "magnitude"]

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


@app.command(epilog="Example: eitbench recordings doctor untouched.csv --sensor bench.toml")
def doctor(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE|SET",
            help="Frames of the untouched sensor: a file (.csv, .npy, .mat, .h5, ...) with a row "
            "for each, or a public recorded set.",
        ),
    ],
    sensor: Annotated[
        str | None, typer.Option(help="The sensor, or a sensor file; of a set: its own.")
    ] = None,
    known: Annotated[
        Path | None,
        typer.Option(help="Frames of this sensor from when its wiring was right, as declared."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="New folder for the page and the sensor file (default: runs/wiring-TIME).",
        ),
    ] = None,
) -> None:
    """Find how a board is wired from frames of the untouched sensor; exits 1 if it cannot tell."""
    from eitbench.commands.wiring import examine
    from eitbench.scenarios.storage.folders import check_empty

    folder = out or new_folder("wiring")
    check_empty(folder)
    said, answered = examine(source, sensor, known, folder)
    for sentence in said:
        typer.echo(sentence)
    if not answered:
        fail(f"No sensor file was written; {folder / 'doctor.html'} shows the best answer.", 1)


@app.command(epilog="Example: eitbench recordings export touch.h5 --to touch.csv")
def export(
    file: Annotated[Path, typer.Argument(metavar="FILE.h5", help="A recording of your own.")],
    to: Annotated[Path, typer.Option(metavar="FILE", help="A new .csv, .mat or .h5 file.")],
) -> None:
    """Write a recording to another file; .h5 makes a cut-off one whole; refuses a damaged one."""
    from eitbench.hardware.recording.exchange import export_recording

    typer.echo(export_recording(file, to))


@app.command(
    "import",
    epilog="Example: eitbench recordings import presses --sensor bench.toml --labels places.csv "
    "--reference baseline.csv --out touch.h5",
)
def import_command(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE",
            help="Files of frames (.csv, .tsv, .txt, .mat, .npy, .npz, .h5, .xlsx), folders or "
            "'press*.csv'; or one public recorded set.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.h5", help="The new recording.")],
    sensor: Annotated[
        str | None,
        typer.Option(help="The sensor, or a sensor file (.toml), if SOURCE does not say."),
    ] = None,
    labels: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="A sheet with a row for each touch: places, states; or an array of SOURCE and its "
            "columns, array:NAME:x_mm,y_mm.",
        ),
    ] = None,
    origin: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="X_MM Y_MM",
            help="Where the origin of the places lies on the sensor, in mm, if it is another.",
        ),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="The untouched sensor: FILE, first:N frames, array:NAME of SOURCE, or none.",
        ),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The array of SOURCE that holds frames, if several may."),
    ] = None,
    order: Annotated[
        Order | None,
        typer.Option(help="A frame (or the values of a drive) is a row or a column."),
    ] = None,
    values: Annotated[Part | None, typer.Option(help="What is taken of complex values.")] = None,
    released: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|alternating",
            help="Each frame is a touch with a frame before it: the array that holds those, or "
            "the frames are released, pressed, released, ...",
        ),
    ] = None,
    differences: Annotated[
        bool, typer.Option(help="Each frame is a touch, pressed minus released.")
    ] = False,
) -> None:
    """Make a recording of files of other programs, or of a public recorded set."""
    from eitbench.hardware.recording.exchange import import_recording
    from eitbench.hardware.recording.importing.arrays import Choice
    from eitbench.hardware.recording.importing.recording import ImportOptions
    from eitbench.scenarios.catalogue import sensor as sensor_by_name

    nominal = None if sensor is None else sensor_by_name(sensor)
    choice = Choice(frames, order, values)
    options = ImportOptions(choice, labels, origin, reference, released, differences)
    for sentence in import_recording(sources, out, nominal, options):
        typer.echo(sentence)
