"""Commands that make, train, tune and check methods."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eitbench.commands.console import Json, print_check, print_json
from eitbench.commands.runs import asked_plan

if TYPE_CHECKING:
    from eitbench.benchmark.tuning.selection import Selection

app = typer.Typer()


@app.command(epilog="Example: eitbench tune quick --methods noser,tv --jobs 2")
def tune(
    suite: Annotated[str, typer.Argument(help="A suite's name, or the path of a suite file.")],
    methods: Annotated[
        str | None, typer.Option(metavar="A,B", help="Tune these methods only.")
    ] = None,
    scenarios: Annotated[
        str | None, typer.Option(metavar="X,Y", help="On these scenarios only.")
    ] = None,
    plugin: Annotated[
        list[Path] | None, typer.Option(metavar="FILE.py", help="A file with more methods.")
    ] = None,
    trials: Annotated[
        int, typer.Option(min=1, help="How many sets of parameters each method may try.")
    ] = 16,
    seconds: Annotated[
        float, typer.Option(min=1, help="Seconds that each method may take in all.")
    ] = 1200.0,
    once: Annotated[
        bool, typer.Option("--once", help="One choice for all scenarios of one ranking figure.")
    ] = False,
    jobs: Annotated[int, typer.Option(min=1, help="Methods at a time.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where the selected ones go (default: your cache)."),
    ] = None,
) -> None:
    """Select hyper-parameters on the validation split; later runs use them (track `tuned`).

    Every method has the same budget. A tuning that was stopped goes on where it stood.
    """
    from eitbench.benchmark.tuning.selection import TuningBudget, at_edge, user_selections
    from eitbench.benchmark.tuning.tuner import tune as choose_all

    plan = asked_plan(suite, methods, scenarios, None, plugin)
    folder = out or user_selections()
    chosen = choose_all(plan, folder, budget=TuningBudget(trials, seconds), once=once, jobs=jobs)
    tuned: set[str] = set()
    selected = False
    for scenario, name, choice in chosen:
        tuned.add(name)
        spent = choice.describe()["spent"]
        if choice.figure is None:
            why = next((f": {t.message}" for t in choice.trials if t.message), "")
            if not choice.trials:
                typer.echo(
                    f"{scenario}  {name}  nothing selected: the first trial takes longer than "
                    f"{seconds:g} s; allow more with --seconds"
                )
                continue
            typer.echo(f"{scenario}  {name}  nothing selected, as no trial gave a figure{why}")
            continue
        selected = True
        typer.echo(
            f"{scenario}  {name}  {json.dumps(choice.parameters)}  {spent['trials']} trials"
            f" ({spent['pruned']} pruned, {spent['failed']} failed), {spent['seconds']:.0f} s"
        )
        typer.echo(f"  {_figures(choice)}")
        for parameter in at_edge(choice.describe()):
            typer.echo(
                f"  {parameter} = {choice.parameters[parameter]} is at the edge of what was tried: "
                "a better value may lie beyond it."
            )
    if left := [name for name in plan.names if name not in tuned]:
        typer.echo(
            f"Nothing to select for {', '.join(left)}, which list no values in `search` "
            "(docs/tuning.md)."
        )
    if not selected:
        return
    typer.echo(f"Selected hyper-parameters: {folder}")
    if out is not None:
        typer.echo("Runs use those in your cache: tune without --out to put them there.")


def _figures(choice: "Selection") -> str:
    """The figures of the defaults and of the selected parameters, as a sentence."""
    from eitbench.benchmark.metrics.specs import METRICS
    from eitbench.reports.tables.columns import METHOD_LAYOUT

    spec = METRICS.get(choice.ranked_by)
    column = METHOD_LAYOUT.column(choice.ranked_by)

    def text(figure: float | None) -> str:
        if figure is None:
            return "no figure"
        return (
            f"{figure:.3f}" if spec is None or column is None else column.number(spec.sign * figure)
        )

    default = choice.trials[0].figure  # the first trial is that of the defaults
    what = "Mean of scaled figures" if spec is None else spec.heading
    return f"{what} on validation data: {text(default)} by default, {text(choice.figure)} selected"


@app.command(epilog="Example: eitbench train dnn --suite paper --jobs 2")
def train(
    name: Annotated[
        str,
        typer.Argument(help="What to train: a method such as dnn, or the operator surrogate."),
    ],
    suite: Annotated[
        str, typer.Option(help="The suite with the data: its name, or the path of its file.")
    ],
    scenario: Annotated[
        str | None, typer.Option(help="Scenario of the suite (default: the first to train on).")
    ] = None,
    epochs: Annotated[
        int | None, typer.Option(min=1, help="Passes over the training data (default: its own).")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Decides all that is random.")] = 0,
    limit: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Training samples (default: all declared; surrogate and tank-unet take no more).",
        ),
    ] = None,
    unlimited: Annotated[
        bool, typer.Option("--unlimited", help="New training samples in every epoch.")
    ] = False,
    start: Annotated[
        str, typer.Option(help="new, or weights to begin with the weights in use.")
    ] = "new",
    loss: Annotated[
        str, typer.Option(help="mse, or log-mse for the mean over images of its logarithm.")
    ] = "mse",
    operator: Annotated[
        str | None,
        typer.Option(help="Forward operator of the physical loss (default: the surrogate)."),
    ] = None,
    alpha: Annotated[
        float, typer.Option(help="Weight of the data loss: 1, or 0 to learn from voltages alone.")
    ] = 1.0,
    beta: Annotated[
        float | None, typer.Option(help="Weight of the physical loss (default: as published).")
    ] = None,
    backbone: Annotated[
        str | None,
        typer.Option(
            help="Network: unet, unet-small, unet-large, mlp, fno or linear (default: its own)."
        ),
    ] = None,
    gain_power: Annotated[
        float,
        typer.Option(
            min=0, help="Power of the gains of measurements that are taken out of training frames."
        ),
    ] = 0.0,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    jobs: Annotated[int, typer.Option(min=1, help="Processes to simulate with.")] = 1,
    install: Annotated[
        str,
        typer.Option(
            help="Use the weights from now on if they are no worse (better), always, or never."
        ),
    ] = "better",
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where the training is kept, to be continued (default: your cache). Weights in "
            "use are in your cache.",
        ),
    ] = None,
) -> None:
    """Train on a suite's data, or continue a training that was stopped."""
    from eitbench.methods.training import TrainingRequest
    from eitbench.methods.training import train as train_named

    request = TrainingRequest(
        name,
        suite,
        scenario=scenario,
        epochs=epochs,
        seed=seed,
        limit=limit,
        unlimited=unlimited,
        start=start,
        loss=loss,
        operator=operator,
        alpha=alpha,
        beta=beta,
        backbone=backbone,
        gain_power=gain_power,
        device=device,
        jobs=jobs,
        out=out,
        install=install,
        progress=True,
    )
    for sentence in train_named(request).sentences():
        typer.echo(sentence)


@app.command(
    epilog="Example: eitbench study beta --epochs 12 --limit 1500 --jobs 2 --out runs/beta"
)
def study(
    name: Annotated[str, typer.Argument(help="beta, physics, size or supervision.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where it is stored, and continued.")],
    suite: Annotated[str, typer.Option(help="The suite with the data.")] = "paper",
    epochs: Annotated[int | None, typer.Option(min=1, help="Of each training.")] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, help="Training samples of each (default: all).")
    ] = None,
    scored: Annotated[
        int | None, typer.Option(min=2, help="Samples to score it on (default: all).")
    ] = None,
    operator: Annotated[
        str, typer.Option(help="Forward operator of the physical loss.")
    ] = "surrogate",
    jobs: Annotated[int, typer.Option(min=1, help="Trainings at a time.")] = 1,
) -> None:
    """Train many networks that differ in one thing, or continue, and say what it is worth."""
    from eitbench.benchmark.studies.training_study import StudyBudget, run_study
    from eitbench.reports.studies.training_study import write_study

    budget = StudyBudget(suite, epochs, limit, scored, operator)
    run_study(name, budget, out, jobs=jobs, progress=True)
    for path in write_study(out):
        typer.echo(str(path))


@app.command("readings", epilog="Example: eitbench readings --jobs 2 --out runs/readings")
def readings_command(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the figures go.")],
    # TV takes seconds for some frames that are read wrongly.
    samples: Annotated[int, typer.Option(min=2, help="How many test samples are used.")] = 120,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Score NOSER and TV with every simple mistake that the published rows could rest on."""
    from eitbench.benchmark.studies.readings import published_readings, write_readings
    from eitbench.reports.tables.published import TABLE_II
    from eitbench.scenarios.storage.folders import check_folder

    check_folder(out)
    rows = {method: TABLE_II[method] for method in ("noser", "tv")}
    table = published_readings(rows, samples=samples, jobs=jobs)
    typer.echo(f"Readings: {write_readings(table, samples, out)}")
    typer.echo(f"Next: eitbench reproduce --study {out}")


@app.command(epilog="Example: eitbench priors --jobs 2 --out runs/priors")
def priors(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the figures go.")],
    samples: Annotated[int, typer.Option(min=2, help="Test samples of each scenario.")] = 120,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
) -> None:
    """Measure what each prior of a method is worth: score it again without that prior."""
    from eitbench.benchmark.studies.priors import worth_of_priors
    from eitbench.reports.studies.priors import priors_table, write_priors
    from eitbench.scenarios.storage.folders import check_folder

    check_folder(out)
    table = worth_of_priors(samples=samples, jobs=jobs)
    typer.echo(priors_table(table))
    for path in write_priors(table, out):
        typer.echo(str(path))


@app.command(epilog="Example: eitbench superposition --out runs/superposition")
def superposition(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the record goes.")],
) -> None:
    """Measure how far real pairs of touches are the sum of single ones, and where they are."""
    from eitbench.benchmark.studies.superposition import record
    from eitbench.reports.studies.superposition import explained_table
    from eitbench.scenarios.storage.atomic_write import atomic_write_json
    from eitbench.scenarios.storage.folders import check_folder

    check_folder(out)
    found = record("eitbench superposition")
    typer.echo(explained_table(found))
    path = out / "superposition.json"
    atomic_write_json(path, found)
    typer.echo(str(path))


@app.command(epilog="Example: eitbench check noser, or: eitbench check my_operator.py")
def check(
    target: Annotated[str, typer.Argument(metavar="NAME|FILE.py", help="What to check.")],
    as_json: Json = False,
) -> None:
    """Check that a method of images or places, or an operator, keeps the contract.

    Exits 1 if any check fails. What a method declares in `expected_failures` is shown as xfail,
    with its reason.
    """
    from eitbench.benchmark.checks import check_target

    reports = check_target(target)
    if as_json:
        print_json([report.describe() for report in reports])
    else:
        for report in reports:
            said = ("", "")
            for result in report.results:
                finding = (result.message, result.trace)
                print_check(result.status, result.name, *(finding if finding != said else ()))
                said = finding
            typer.echo(report.summary())
    if not all(report.passed for report in reports):
        raise typer.Exit(1)


@app.command("new-method", epilog="Example: eitbench new-method my-method")
def new_method_command(
    name: Annotated[str, typer.Argument(help="Small letters, digits and hyphens.")],
    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="New folder (default: eitbench-NAME).")
    ] = None,
    learned: Annotated[
        bool, typer.Option("--learned", help="A network with its training, not a formula.")
    ] = False,
) -> None:
    """Write an installable package around a method that works, to put yours in its place."""
    from eitbench.commands.scaffold import new_method

    written = new_method(name, folder, learned=learned)
    for path in written:
        typer.echo(str(path))
    train = f" && python {shlex.quote(str(written[2]))}" if learned else ""
    package = shlex.quote(str(written[0].parent))
    typer.echo(f"Next: pip install -e {package}{train} && eitbench check {name}")
