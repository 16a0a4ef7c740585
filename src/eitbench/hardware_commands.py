"""Commands that work with a board: a real one, an emulated one, or a recording."""

from typing import Annotated

import typer

from eitbench.console import Json, print_json, print_renderable

app = typer.Typer()


@app.command(epilog="Example: eitbench calibrate sciospec-tank")
def calibrate(
    recording: Annotated[
        str, typer.Argument(metavar="NAME|FILE.h5", help="A recorded set, or a recording.")
    ],
    as_json: Json = False,
) -> None:
    """Say what the untouched frame of a recording tells of its sensor and board."""
    from eitbench.reports.calibration import table
    from eitbench.scenarios.calibration import calibrate as found_in
    from eitbench.scenarios.recordings import recorded_set
    from eitbench.scenarios.recordings.fetch import read_recording

    reference = read_recording(recording).reference
    found = found_in(recorded_set(recording).sensor(), reference[None]).describe()
    if as_json:
        print_json(found)
    else:
        print_renderable(table(found))
