"""Console of the commands: lists of names as options, output for people and programs, errors."""

import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]


def print_json(value: Any) -> None:
    """Print plain values as JSON."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False, default=str))


def print_renderable(renderable: Any) -> None:
    """Print what rich can render, as wide as the terminal."""
    from rich.console import Console

    Console(width=width(), highlight=False).print(renderable)


def print_check(status: str, name: str, message: str = "", trace: str = "") -> None:
    """Print the outcome of one of several checks, with what was wrong below it, and where."""
    typer.echo(f"{'FAILED' if status == 'failed' else status:7s}  {name}")
    for line in (*([message] if message else []), *trace.splitlines()):
        typer.echo(f"         {line}")


def width() -> int:
    """Characters in a line; without a terminal nothing is folded, so that grep works."""
    import shutil

    return shutil.get_terminal_size().columns if sys.stdout.isatty() else 400


def names_in(option: str, text: str | None) -> Sequence[str]:
    """The names in `text`, each once; none where the option was not given."""
    parts = (name.strip() for name in (text or "").split(","))
    names = list(dict.fromkeys(filter(None, parts)))
    if text is not None and not names:
        raise typer.BadParameter(f"{option} names nothing: give names with commas between them")
    return names


def new_folder(name: str) -> Path:
    """The folder for results that the user named none for."""
    return Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"


def finite(value: Any) -> Any:
    """Return `value`, or None for a float that JSON lacks: infinite or NaN."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def fail(sentence: str, code: int, notes: Sequence[str] = ()) -> NoReturn:
    """Say what went wrong, and where if that is noted, and exit with `code`."""
    warn(sentence)
    for note in filter(None, notes):
        typer.echo(note, err=True)
    sys.exit(code)


def warn(sentence: str) -> None:
    """One sentence on stderr."""
    typer.echo(f"eitbench: {' '.join(sentence.split())}", err=True)
