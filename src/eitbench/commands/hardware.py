"""Commands that work with a board: a real one, an emulated one, or a recording."""

import shlex
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eitbench.commands.console import Json, print_json, print_renderable

if TYPE_CHECKING:
    from eitbench.hardware.board import Board
    from eitbench.hardware.recording.recorder import Recorder

app = typer.Typer()

BoardName = Annotated[str, typer.Option(metavar="NAME", help="A board (eitbench list boards).")]
Port = Annotated[str | None, typer.Option(help="The serial port of a real board.")]
SensorName = Annotated[
    str | None,
    typer.Option(help="The sensor on it, or a sensor file, .toml (default: the board's)."),
]
PlayedFile = Annotated[str | None, typer.Option(metavar="SET|FILE.h5", help="What `replay` plays.")]
Script = Annotated[
    Path | None, typer.Option(metavar="FILE.toml", help="A file of touches for `emulator`.")
]
Protocol = Annotated[
    str | None,
    typer.Option(metavar="BOARD", help="The board that `emulator` imitates (default: teensy)."),
]
Speed = Annotated[float | None, typer.Option(help="Speed of `replay` and `emulator`, as a factor.")]


@app.command(epilog="Example: eitbench calibrate sciospec-tank")
def calibrate(
    recording: Annotated[
        str, typer.Argument(metavar="NAME|FILE.h5", help="A recorded set, or a recording.")
    ],
    as_json: Json = False,
) -> None:
    """Estimate gains, electrode places and contacts from the reference frames of a recording."""
    from eitbench.commands.tables import calibration_table
    from eitbench.scenarios.imperfections.calibration import calibrate as calibrate_frames
    from eitbench.scenarios.recordings.fetch import reference_frames

    found = calibrate_frames(*reference_frames(recording)).describe()
    if as_json:
        print_json(found)
    else:
        print_renderable(calibration_table(found))


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
    from eitbench.hardware.registry import make_emulator
    from eitbench.scenarios.catalogue import sensor as sensor_by_name

    nominal = None if sensor is None else sensor_by_name(sensor)
    board = make_emulator(nominal, protocol, script, speed)
    typer.echo("Getting ready, which takes some seconds.", err=True)
    board.switch_on()
    try:
        typer.echo(
            f"emulated board on {board.port} (speaks {protocol!r}): no real sensor. Ctrl-C ends it."
        )
        board.serve()
    finally:
        board.switch_off()


def _board(name: str, sensor: str | None, **options: Any) -> "Board":
    """Make the board `name` with the options of the command line."""
    from eitbench.hardware.registry import make_board
    from eitbench.scenarios.catalogue import sensor as sensor_by_name

    nominal = None if sensor is None else sensor_by_name(sensor)
    return make_board(name, sensor=nominal, **options)


@app.command(epilog="Example: eitbench record --board emulator --guided --out touch.h5")
def record(
    board: BoardName,
    out: Annotated[Path, typer.Option(metavar="FILE.h5", help="The new recording.")],
    port: Port = None,
    sensor: SensorName = None,
    seconds: Annotated[float | None, typer.Option(min=0, help="Time (default: to Ctrl-C).")] = None,
    file: PlayedFile = None,
    script: Script = None,
    protocol: Protocol = None,
    speed: Speed = None,
    guided: Annotated[
        bool, typer.Option("--guided", help="Record touches step by step, for a suite.")
    ] = False,
) -> None:
    """Record a board into a file, free-running or guided."""
    from eitbench.hardware.recording.guided import (
        GuidedSession,
        suite_path,
        write_suite,
    )
    from eitbench.hardware.recording.recorder import Recorder, check_new
    from eitbench.scenarios.interrupts import termination_interrupts

    if guided and seconds is not None:
        raise typer.BadParameter("a guided session ends when you say so: leave out --seconds")
    check_new(out)  # before a board is waited for
    suite = suite_path(out) if guided else None
    made = _board(
        board, sensor, port=port, file=file, script=script, protocol=protocol, speed=speed
    )
    with termination_interrupts(), made:
        recorder = Recorder(out, made.sensor, board, firmware=made.firmware, emulated=made.emulated)
        session = GuidedSession(made, recorder, _ask, typer.echo)
        try:
            with recorder:
                if guided:
                    session.run()
                else:
                    _record_with_status(made, recorder, seconds)
        finally:  # the frames so far are usable, however it ended
            scored = suite is not None and not session.lacks
            if suite is not None and scored:
                write_suite(suite, out, made.sensor, board, emulated=made.emulated)
            # Printed last: the terminal may be gone.
            if count := recorder.written:
                shown = shlex.quote(str(out))
                typer.echo(f"{count} frames are in {out}: eitbench recordings check {shown}")
            if scored:
                typer.echo(f"Score methods on them: eitbench run {shlex.quote(str(suite))}")


def _ask(question: str) -> str:
    answer: str = typer.prompt(question, default="", show_default=False, prompt_suffix=" ")
    return answer


def _record_with_status(board: "Board", recorder: "Recorder", seconds: float | None) -> None:
    """Record, with a status line that moves."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    from eitbench.hardware.recording.loop import record as record_frames

    console = Console(stderr=True)
    # Without a terminal a line that moves would leave but fragments.
    with Live(console=console, transient=True, auto_refresh=False) as live:
        try:
            record_frames(
                board,
                recorder,
                seconds=seconds,
                show=lambda status: live.update(Text(status.line()), refresh=console.is_terminal),
                say=lambda sentence: console.print(sentence, highlight=False, markup=False),
            )
        except KeyboardInterrupt:
            console.print("Interrupted: the recording ends here.")


@app.command(epilog="Example: eitbench live --board emulator --method noser")
def live(
    board: BoardName,
    port: Port = None,
    file: PlayedFile = None,
    sensor: SensorName = None,
    script: Script = None,
    protocol: Protocol = None,
    speed: Speed = None,
    method: Annotated[
        str | None,
        typer.Option(help="Makes the images at first (default: noser, or that of the plugin)."),
    ] = None,
    choice: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.json",
            help="Begin with the method and the parameters that `eitbench choose` chose.",
        ),
    ] = None,
    plugin: Annotated[
        list[Path] | None, typer.Option(metavar="FILE.py", help="A file with more methods.")
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", file_okay=False, help="Where recordings go.")
    ] = Path(),
    http_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes any.")
    ] = 8765,
    host: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Let other machines look; needs a token."),
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            dir_okay=False,
            exists=True,
            help="Holds the token that they have to know (default: EITBENCH_TOKEN).",
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Watch a board on a page in the browser: images, contacts, voltages; record what it sends."""
    import os

    from eitbench.benchmark.workers.worker import plugin_names
    from eitbench.hardware.live.run import live_view
    from eitbench.hardware.live.server import access_to
    from eitbench.methods.registry import load_plugin
    from eitbench.scenarios.interrupts import termination_interrupts

    if choice is not None and method is not None:
        raise typer.BadParameter("--choice names the method: leave out --method")
    access = access_to(host, token_file, os.environ.get("EITBENCH_TOKEN", ""))
    added = []
    for path in plugin or ():
        plugin_names(path)  # in a process of its own, which tells where it raises an error
        added += load_plugin(path).methods
    method = method or (added[0] if added else "noser")
    made = _board(
        board, sensor, port=port, file=file, script=script, protocol=protocol, speed=speed
    )
    parameters: dict[str, dict[str, Any]] = {}
    if choice is not None:
        from eitbench.benchmark.choice.decision import read_choice

        method, parameters = read_choice(choice, made.sensor)

    with (
        termination_interrupts(),
        live_view(
            made, board, method, access=access, port=http_port, out=out, parameters=parameters
        ) as view,
        suppress(KeyboardInterrupt),
    ):
        emulated = " (emulated)" if made.emulated else ""
        typer.echo(f"{board}{emulated}: {view.address}  (Ctrl-C ends it)")
        # A list of processes would show the token in the browser's command line.
        if browser and sys.stdout.isatty() and not access.token:
            import webbrowser

            webbrowser.open(view.address)
        view.serve()
