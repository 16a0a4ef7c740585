"""The command that works out how well simulated touches could be known at best."""

from pathlib import Path
from typing import Annotated

import typer

from eitbench.commands.console import (
    Json,
    finite,
    names_in,
    print_json,
    print_renderable,
    warn,
)

app = typer.Typer()

_HEADS = {
    "scenario": ("Scenario", ""), "n": ("n", "d"), "psnr_of_mse": ("PSNR of MSE [dB]", ".2f"),
    "psnr": ("PSNR [dB]", ".2f"), "ssim": ("SSIM", ".3f"), "cc": ("CC", ".3f"),
    "rie": ("RIE", ".4f"), "localisation_mm": ("Place [mm]", ".2f"),
    "expected_psnr": ("Expected [dB]", ".2f"), "apart_db": ("Samplers apart [dB]", "+.2f"),
    "agreed": ("R-hat agrees", ".0%"), "exact": ("Exact", ".1%"),
    "within_95": ("In 95 %", ".0%"),
}  # fmt: skip


@app.command(epilog="Example: eitbench ceiling noise --samples 12 --jobs 2 --out runs/ceiling")
def ceiling(
    suite: Annotated[str, typer.Argument(help="Name of a suite, or a suite file, .toml.")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where draws and figures go; a stopped run goes on.")
    ],
    scenarios: Annotated[
        str | None, typer.Option(metavar="X,Y", help="These scenarios only (default: all).")
    ] = None,
    samples: Annotated[
        int, typer.Option(min=2, help="First test samples of each scenario, or all of them.")
    ] = 200,
    record: Annotated[
        bool,
        typer.Option(
            "--record",
            help="Draw only frames that eitbench's own record lacks, and those by an earlier "
            "sampler whose draws are doubtful.",
        ),
    ] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    as_json: Json = False,
) -> None:
    """Work out how well the touches of a suite could be known by a method that knows their law.

    Two samplers draw from the posterior of every frame, told the families, their ranges, the noise,
    the mesh and the electrodes. A frame takes one to five minutes of a core, the longer the less
    noise it has, and more than ten if it may be of four contacts, as in `shapes`; clean frames get
    70 dB. Scenarios that they cannot be told are left out unless --scenarios names them.
    """
    from eitbench.benchmark.ceiling.drawing import draw_posteriors, known_of
    from eitbench.benchmark.ceiling.figures import summary, write_record
    from eitbench.benchmark.rundir.store import unused
    from eitbench.commands.tables import names_table
    from eitbench.scenarios.errors import InputError, unknown_name
    from eitbench.scenarios.storage.folders import check_folder
    from eitbench.scenarios.suites.suite import load_suite

    check_folder(out)
    draws = out / "draws"
    if out.is_dir() and not (draws.is_dir() or unused(out)):
        raise InputError(f"{out} holds other things than draws: name another folder for --out.")
    found, chosen = load_suite(suite), names_in("--scenarios", scenarios)
    declared = {scenario.name: scenario for scenario in found.scenarios}
    if unknown := [name for name in chosen if name not in declared]:
        raise unknown_name("scenario", unknown[0], declared)
    which = [declared[name] for name in chosen]
    if not chosen:
        which, refused = known_of(declared.values())
        if refused and not which:
            raise refused[0]
        if refused:
            why = "\n".join(map(str, refused))
            warn(f"{len(refused)} of {len(declared)} scenarios are left out:\n{why}")
    draw_posteriors(which, draws, samples, record=record, jobs=jobs, progress=not as_json)
    frames = write_record(draws, found.name, which, samples, out, record=record)
    rows = summary(frames).to_dict("records")
    if as_json:
        print_json([{name: finite(value) for name, value in row.items()} for row in rows])
        return
    print_renderable(
        names_table(
            [
                {head: format(row[name], form) for name, (head, form) in _HEADS.items()}
                for row in rows
            ]
        )
    )
    typer.echo(f"Frames: {out / f'{found.name}.csv'}")
