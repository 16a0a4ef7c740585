"""Commands that work with a board: a real one, an emulated one, or a recording."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()


@app.command(epilog="Example: eitbench emulate --protocol openeit --script touches.toml")
def emulate(
    protocol: Annotated[
        str, typer.Option(metavar="BOARD", help="Speak as this board (eitbench list boards).")
    ] = "teensy",
    sensor: Annotated[
        str | None, typer.Option(help="The sensor on it (default: the board's).")
    ] = None,
    script: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Touches: when, where, how hard.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Times 10 frames/s.")] = 1.0,
) -> None:
    """Emulate a board on a serial port of its own, for another program to open, until Ctrl-C."""
    from eitbench.hardware.boards import make_emulator
    from eitbench.scenarios.catalogue import sensor as sensor_by_name

    nominal = None if sensor is None else sensor_by_name(sensor)
    board = make_emulator(nominal, protocol, script, speed)
    board.switch_on()
    try:
        typer.echo(f"{board.title}: no real sensor. Ctrl-C ends it.")
        board.serve()
    finally:
        board.switch_off()
