"""The command that measures how soon a live view shows a touch, and how long it stays."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eitbench.commands.console import Json, finite, names_in, print_json, print_renderable

if TYPE_CHECKING:
    import pandas as pd

    from eitbench.hardware.live.latency import Latencies

app = typer.Typer()


@app.command(epilog="Example: eitbench latency foam16 --methods noser,greit --snr 60")
def latency(
    sensor: Annotated[
        str,
        typer.Argument(
            metavar="SENSOR|SET", help="A sensor's name or file, .toml, or a recorded set."
        ),
    ],
    snr: Annotated[
        float | None,
        typer.Option(min=0, max=200, help="SNR of a frame in dB; has to be given."),
    ] = None,
    methods: Annotated[
        str, typer.Option(metavar="A,B", help="Methods that can be used live.")
    ] = "noser",
    frame_rate: Annotated[float, typer.Option(help="Frames/s of the board.")] = 10.0,
    touches: Annotated[int, typer.Option(min=1, help="Number of places and phases.")] = 20,
    radius: Annotated[
        float | None,
        typer.Option(help="Radius of the touch in mm (default: 5 % of the sensor's shorter side)."),
    ] = None,
    reference_age: Annotated[
        float, typer.Option(help="Age of the reference before the first frame, in s.")
    ] = 10.0,
    seed: Annotated[int, typer.Option(min=0, help="Of places, phases and units.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where tables and the figure go.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure how soon the live view shows a touch, and how long it stays after the release.

    An emulated board measures light, medium and firm touches value by value, in an ideal material
    and in one that drifts and relaxes; the pipeline of `eitbench live` makes images of them.
    """
    from eitbench.benchmark.rundir.manifest import cpu_model, git_commit
    from eitbench.hardware.live.latency import measure
    from eitbench.reports.tables.latency import latency_rows, latency_table
    from eitbench.scenarios.catalogue import sensor as sensor_by_name
    from eitbench.scenarios.storage.folders import check_empty

    check_empty(out)
    nominal = sensor_by_name(sensor)
    found = measure(
        nominal, list(names_in("--methods", methods)), snr, frame_rate=frame_rate,
        touches=touches, radius_m=None if radius is None else radius / 1e3,
        reference_age_s=reference_age, seed=seed, show=True,
    )  # fmt: skip
    table = latency_table(found.touches, found.image_ms)
    about = {
        "sensor": nominal.name, "snr_db": finite(snr), "frame_rate": frame_rate, "touches": touches,
        "radius_mm": 1e3 * found.radius_m, "distance_mm": 1e3 * found.distance_m,
        "reference_age_s": reference_age, "seed": seed,
        "processor": cpu_model(), "git_commit": git_commit(),
        "methods": [{k: finite(v) for k, v in row.items()} for row in table.to_dict("records")],
    }  # fmt: skip
    if out is not None:
        _write(out, found, table, about, 1 / frame_rate)
    if as_json:
        print_json(about)
        return
    from eitbench.commands.tables import names_table

    heads, *texts = latency_rows(table)
    typer.echo(
        f"{nominal.name}: {touches} touches of radius {1e3 * found.radius_m:.3g} mm, detected "
        f"within {1e3 * found.distance_m:.3g} mm; {frame_rate:g} frames/s of {snr:g} dB; reference "
        f"{reference_age:g} s old; medians (95th percentiles); images on {about['processor']}, one "
        "thread"
    )
    print_renderable(names_table([dict(zip(heads, row, strict=True)) for row in texts]))
    if out is not None:
        typer.echo(f"Tables and figure: {out}")


def _write(
    out: Path, found: "Latencies", table: "pd.DataFrame", about: dict[str, Any], frame_s: float
) -> None:
    """Write latency.csv, touches.csv, latency.json and the figure into the folder `out`."""
    import matplotlib as mpl

    from eitbench.reports.figures.latency import latency_figure
    from eitbench.reports.figures.style import STYLE, save
    from eitbench.reports.tables.formats import csv_text
    from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json

    for name, rows in (("latency", table), ("touches", found.touches)):
        atomic_write(out / f"{name}.csv", csv_text(rows, "%.5g").encode())
    atomic_write_json(out / "latency.json", about)
    with mpl.rc_context(STYLE):
        save(latency_figure(found.images, frame_s), out / "latency")
