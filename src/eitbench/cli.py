"""The command line: it reads arguments, calls the folders' functions and prints.

Libraries that take long to import are imported by the command that needs them, so that
`eitbench --help` answers at once.
"""

import errno
import io
import os
import sys
from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any, NoReturn

import typer

from eitbench.commands import board as board_commands
from eitbench.commands import ceiling as ceiling_commands
from eitbench.commands import choose as choose_commands
from eitbench.commands import design as design_commands
from eitbench.commands import hardware as hardware_commands
from eitbench.commands import hidden as hidden_commands
from eitbench.commands import latency as latency_commands
from eitbench.commands import methods as method_commands
from eitbench.commands import recordings as recording_commands
from eitbench.commands import results as result_commands
from eitbench.commands import runs as run_commands
from eitbench.commands import submission as submission_commands
from eitbench.commands.console import Json, fail, print_json, print_renderable

app = typer.Typer(
    help="The benchmark for electrical impedance tomography (EIT) tactile sensing.",
    epilog="Example: eitbench run quick",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


Listing = StrEnum(
    "Listing",
    [
        "methods",
        "place-methods",
        "operators",
        "scenarios",
        "families",
        "sensors",
        "suites",
        "recordings",
        "boards",
    ],
)


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
    """List methods (of images or places), operators, scenarios, sensors, suites and so on."""
    from eitbench.commands.listing import LISTINGS

    rows = LISTINGS[what.value]()
    if as_json:
        print_json(rows)
    else:
        from eitbench.commands.tables import names_table

        print_renderable(names_table(rows))


for commands in (
    run_commands,
    result_commands,
    board_commands,
    design_commands,
    ceiling_commands,
    choose_commands,
    method_commands,
    hardware_commands,
    latency_commands,
):
    app.add_typer(commands.app)
app.add_typer(recording_commands.app, name="recordings")
app.add_typer(hidden_commands.app, name="hidden")
app.add_typer(submission_commands.app, name="submission")


def main() -> None:
    """Run the command line; every error becomes one sentence and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Files and pipes are read as UTF-8; of a terminal, whatever it can show.
            if stream.isatty():
                stream.reconfigure(errors="replace")
            else:
                stream.reconfigure(encoding="utf-8")
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
    except SystemExit as end:
        # Typer ends so after a broken pipe.
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        # The reader (head, less) has seen enough; nothing may be flushed to it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except KeyboardInterrupt:
        fail("Interrupted.", 130)
    except Exception as error:
        if isinstance(error, _UsageError):
            _fail_usage(error)
        if debug:
            raise
        from eitbench.scenarios.errors import EitbenchError

        if isinstance(error, ModuleNotFoundError):
            from eitbench.scenarios.extras import EXTRAS, missing

            module = (error.name or "").partition(".")[0]
            if module in EXTRAS and (why := missing(module)):
                fail(why, 1)
        if isinstance(error, EitbenchError):
            fail(str(error), error.exit_code, getattr(error, "__notes__", ()))
        if isinstance(error, OSError) and error.filename is not None:
            fail(f"Could not use {error.filename}: {error.strerror}.", 1)
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            fail("The output could not be written whole: no space is left where it goes.", 1)
        fail(
            f"Unexpected {type(error).__name__}: {error}. Add --debug for the traceback, and "
            "please report it.",
            1,
        )
    if code == 130:
        fail("Interrupted.", 130)
    return code if isinstance(code, int) else 0


def _fail_usage(error: Any) -> NoReturn:
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        sys.exit(2)
    message = str(error.format_message()).replace(": Value error, ", ": ")
    sentence = message.removeprefix("Invalid value: ").rstrip(".")
    command = error.ctx.command_path if error.ctx is not None else "eitbench"
    fail(f"{sentence[:1].upper()}{sentence[1:]}; see `{command} --help`.", 2)


if __name__ == "__main__":
    main()
