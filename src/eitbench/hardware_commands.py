"""Commands that work with a board: a real one, an emulated one, or a recording."""

import typer

app = typer.Typer()
