"""Commands that deal with recorded sensor sets."""

from typing import Annotated

import typer

app = typer.Typer(
    help="Recorded sensor sets.",
    epilog="Example: eitbench recordings fetch ohmc16",
    no_args_is_help=True,
)


@app.command(epilog="Example: eitbench recordings fetch ohmc16")
def fetch(
    name: Annotated[str, typer.Argument(help="A recorded set (eitbench list recordings).")],
) -> None:
    """Find or download a recorded set and verify it."""
    from eitbench.scenarios.recordings import recorded_set
    from eitbench.scenarios.recordings.fetch import intact

    typer.echo(f"{name} is in {intact(recorded_set(name), progress=True)}")
