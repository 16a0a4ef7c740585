"""The command that says which method to put behind a sensor."""

from pathlib import Path
from typing import Annotated

import typer

from eitbench.commands.console import (
    Json,
    names_in,
    new_folder,
    print_json,
    print_renderable,
    warn,
)

app = typer.Typer()


@app.command(epilog="Example: eitbench choose ohmc16 --time-limit 300 --out runs/choice")
def choose(
    sensor: Annotated[
        str,
        typer.Argument(
            metavar="SET|SENSOR",
            help="A recorded set, a sensor, a sensor file (.toml) or a recording (.h5).",
        ),
    ],
    time_limit: Annotated[
        float, typer.Option(metavar="SECONDS", help="Time for all methods together.")
    ] = 300.0,
    frame_rate: Annotated[
        float, typer.Option(help="Frames/s that 95 % of the frames have to keep up with.")
    ] = 10.0,
    methods: Annotated[
        str | None, typer.Option(metavar="A,B", help="Try these methods only.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder (default: runs/choose-TIME).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say which method to put behind a sensor, and why.

    Tries methods on labelled frames, if there are any, and on simulated touches, the cheapest
    first: the best within the deadline, without a GPU, and when drift is expected.
    """
    import pandas as pd

    from eitbench.benchmark.choice.measure import choose as chosen
    from eitbench.benchmark.run.progress import RunProgress
    from eitbench.commands.tables import names_table
    from eitbench.reports.tables.choice import choice_rows, sentence
    from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json

    folder = out or new_folder("choose")
    choice = chosen(
        sensor,
        folder,
        frame_rate=frame_rate,
        time_limit_s=time_limit,
        methods=names_in("--methods", methods),
        progress=RunProgress(),
    )
    choice = choice.model_copy(update={"answer": sentence(choice)})
    plain = choice.model_dump(mode="json")
    table = pd.json_normalize(plain["tried"], sep="_").to_csv(index=False, lineterminator="\n")
    atomic_write(folder / "choice.csv", table.encode())
    atomic_write_json(folder / "choice.json", plain)
    if choice.note:
        warn(choice.note)
    if as_json:
        print_json(plain)
        return
    typer.echo(choice.answer)
    print_renderable(names_table(choice_rows(choice)))
    if choice.unusable:
        typer.echo(
            f"Not usable here, or failed (choice.json says why): {', '.join(choice.unusable)}"
        )
    typer.echo(f"Choice: {folder / 'choice.json'} (eitbench live --choice)")
