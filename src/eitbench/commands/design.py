"""The command that says what a sensor can feel before it is built."""

from pathlib import Path
from typing import Annotated, Any

import typer

from eitbench.commands.console import Json, finite, names_in, print_json, print_renderable

app = typer.Typer()


@app.command(
    epilog="Example: eitbench design foam16 --snr 60 --compare offset=1,offset=3,opposition"
)
def design(
    sensor: Annotated[
        str, typer.Argument(help="Name of a sensor or recorded set, or a file, .toml.")
    ],
    snr: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=200,
            help="SNR in dB of a frame of the sensor as it is given; has to be given.",
        ),
    ] = None,
    drift: Annotated[
        float,
        typer.Option(min=0, max=50, help="Drift of the conductivity since the reference [%]."),
    ] = 0.0,
    compare: Annotated[
        str | None,
        typer.Option(
            metavar="A,B", help="Patterns: offset=K, opposition or own (default: its own)."
        ),
    ] = None,
    electrodes: Annotated[
        str | None,
        typer.Option(metavar="N,M", help="Numbers of electrodes (default: the sensor's)."),
    ] = None,
    radius: Annotated[
        float | None,
        typer.Option(
            help="Radius of the touch in mm (default: 5 % of the sensor's shorter side, and at "
            "least 1.5 pixels)."
        ),
    ] = None,
    contrast: Annotated[
        float, typer.Option(help="Its greatest contrast over the background, above -1.")
    ] = -0.3,
    measurement_ms: Annotated[
        float | None,
        typer.Option(help="Time of one value in ms (default: 10 frames/s of the sensor as it is)."),
    ] = None,
    frame_rate: Annotated[
        float | None,
        typer.Option(help="Frames/s that a design has to reach; faster ones average frames."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where tables and the figure go.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what a sensor can feel before it is built, and which pattern is best.

    Bounds that no unbiased method beats: of place, strength and size of a touch, of the smallest
    touch and of two points; medians over the sensor, maps with --out.
    """
    from eitbench.benchmark.design.bounds import Touch
    from eitbench.benchmark.design.designs import best, default_touch
    from eitbench.benchmark.design.designs import compare as compared
    from eitbench.reports.tables.design import ambiguity, design_rows, design_table, title
    from eitbench.scenarios.catalogue import sensor as sensor_by_name
    from eitbench.scenarios.storage.folders import check_empty

    check_empty(out)
    nominal = sensor_by_name(sensor)
    touch = Touch(default_touch(nominal).radius if radius is None else radius / 1e3, contrast)
    designs = compared(
        nominal, snr, touch=touch, drift=drift / 100,
        patterns=names_in("--compare", compare), electrodes=_counts(electrodes),
        measurement_s=None if measurement_ms is None else measurement_ms / 1e3,
        frame_rate=frame_rate,
    )  # fmt: skip
    table = design_table(designs)
    chosen = best(designs)
    within = "" if frame_rate is None else f" within {frame_rate:g} frames/s"
    answer = (
        f"No design reaches {frame_rate:g} frames/s: measure faster (`--measurement-ms`), or take "
        "fewer electrodes."
        if chosen is None
        else f"Smallest bound of the place{within}: {title(chosen)}." + ambiguity(chosen)
    )
    settings = {
        "sensor": nominal.name, "snr_db": snr, "drift_percent": drift,
        "radius_mm": 1e3 * touch.radius, "contrast": contrast, "frame_rate": frame_rate,
    }  # fmt: skip
    rows = [{k: finite(v) for k, v in row.items()} for row in table.to_dict("records")]
    about = {
        **settings, "designs": rows, "best": None if chosen is None else title(chosen)
    }  # fmt: skip
    if out is not None:
        _write(out, designs, about)
    if as_json:
        print_json(about)
        return
    from eitbench.commands.tables import names_table

    heads, *texts = design_rows(table)
    typer.echo(
        f"{nominal.name}: a touch of radius {1e3 * touch.radius:.3g} mm and contrast {contrast:g}, "
        f"frames of {snr:g} dB, drift {drift:g} %; medians over the sensor"
    )
    print_renderable(names_table([dict(zip(heads, row, strict=True)) for row in texts]))
    typer.echo(answer)
    if out is not None:
        from eitbench.reports.figures.design import drawn_designs

        drawn, fast = len(drawn_designs(designs)), sum(of.maps is not None for of in designs)
        some = f" (maps of the {drawn} best of {fast} designs)" if drawn < fast else ""
        typer.echo(f"Tables and figure{some}: {out}")


def _counts(text: str | None) -> list[int]:
    names = names_in("--electrodes", text)
    if wrong := [name for name in names if not name.isdecimal()]:
        raise typer.BadParameter(
            f"--electrodes takes whole numbers with commas between them, got {wrong[0]!r}"
        )
    return [int(name) for name in names]


def _write(out: Path, designs: Any, about: dict[str, Any]) -> None:
    """Write designs.csv, places.csv, design.json and the figure into the folder `out`."""
    import matplotlib as mpl

    from eitbench.reports.figures.design import design_figure
    from eitbench.reports.figures.style import STYLE, save
    from eitbench.reports.tables.design import design_table, places_table
    from eitbench.reports.tables.formats import csv_text
    from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json

    for name, table in (("designs", design_table(designs)), ("places", places_table(designs))):
        atomic_write(out / f"{name}.csv", csv_text(table, "%.5g").encode())
    atomic_write_json(out / "design.json", about)
    if any(of.maps is not None for of in designs):
        with mpl.rc_context(STYLE):
            save(design_figure(designs), out / "design")
