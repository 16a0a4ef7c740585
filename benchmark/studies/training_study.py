"""Training studies: many trainings that differ in one respect, scored alike, and resumable.

And the learning curves that lie beside trained weights.

The folder of a study holds `study.json` with its settings, a folder for each training with its
learning curve and its `samples.parquet`, and at the end one `samples.parquet` of all: one row per
training, scenario and sample.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import joblib
import numpy as np
import pandas as pd

from eitbench.benchmark.analysis.results import read_json, read_table
from eitbench.benchmark.metrics.evaluation import evaluate
from eitbench.benchmark.rundir.lock import FILE_NAME as LOCK
from eitbench.benchmark.rundir.lock import locked
from eitbench.benchmark.rundir.store import SAMPLES
from eitbench.methods import Problem, create
from eitbench.methods.learned.image_networks import TrainedMethod
from eitbench.methods.method import reconstructed
from eitbench.methods.problem import no_split
from eitbench.methods.registry import methods
from eitbench.methods.training import (
    DivergedError,
    TrainingInterruptedError,
    TrainingRequest,
    train,
)
from eitbench.methods.training.samples import training_scenario
from eitbench.methods.weights.weight_files import sensor_key
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import DataCorruptError, InputError, unknown_name
from eitbench.scenarios.interrupts import termination_interrupts, worker_pool
from eitbench.scenarios.sensors.sensor import Sensor, foam16
from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from eitbench.scenarios.suites.scenario import Split

Variant = Mapping[str, Any]

METRICS = ("ssim", "cc", "rie", "psnr", "score")

BETAS = tuple(float(f"{beta:.3g}") for beta in np.geomspace(1e-4, 0.5, 52))
"""As many values as published, between the same ends; the published spacing is not stated."""

OTHER_SUITES = ("noise", "shapes")
"""Suites that trainings are scored on beside their own data, if the sensor is the same."""


@dataclass(frozen=True)
class TrainingStudy:
    """A question that trainings answer.

    Attributes:
        grid: values by name; every combination is trained.
        split: split of the training's scenario that is scored.
        elsewhere: true if the test splits of `OTHER_SUITES` are scored, too.
        changes: fields of the training request of a combination.
    """

    grid: Mapping[str, Sequence[Any]]
    split: Split
    elsewhere: bool
    changes: Callable[[Variant], Mapping[str, Any]]


def _with_loss(variant: Variant) -> Variant:
    physics = variant["physics"]
    kind = {"name": "dnn"} if physics == "none" else {"operator": physics}
    return {"seed": variant["seed"], **kind}


STUDIES: dict[str, TrainingStudy] = {
    # Which weight of the physical loss is best?
    "beta": TrainingStudy({"beta": BETAS}, "validation", False, dict),
    # Does a physical loss help, and through which operator?
    "physics": TrainingStudy(
        {"physics": ("none", "surrogate", "fem"), "seed": (0, 1, 2)}, "test", True, _with_loss
    ),
    # What are the true images of the training worth?
    "supervision": TrainingStudy({"alpha": (1.0, 0.0), "seed": (0, 1, 2)}, "test", False, dict),
    # What are more data and a larger network worth?
    "size": TrainingStudy(
        {"samples": (750, 1500, 3000, 6000), "backbone": ("unet-small", "unet")},
        "validation",
        False,
        lambda of: {"name": "dnn", "limit": of["samples"], "backbone": of["backbone"]},
    ),
}


@dataclass(frozen=True)
class StudyBudget:
    """Settings of a study that are the same for all its trainings.

    Attributes:
        suite: suite with the data.
        epochs: of each training.
        limit: training samples; all by default.
        scored: samples of each scenario that a training is scored on; all by default.
        operator: forward operator of the physical loss, unless the study varies it.
    """

    suite: str
    epochs: int | None = None
    limit: int | None = None
    scored: int | None = None
    operator: str = "surrogate"


def run_study(
    name: str, budget: StudyBudget, out: Path, *, jobs: int = 1, progress: bool = False
) -> pd.DataFrame:
    """Train and score all of a study, or the rest of it in the folder `out`.

    Returns one row per training, scenario and sample: the variant, `scenario`, `sample`, `METRICS`,
    `train_s`. A training that diverged has one row without figures.

    Raises:
        InputError: no such study, one that does not fit its suite or its budget, a folder of
            another, or one that another process works in.
        TrainingInterruptedError: Ctrl-C or SIGTERM; all processes have ended.
        EitbenchError: as for `train`.
    """
    if name not in STUDIES:
        raise unknown_name("study", name, STUDIES)
    scenario = training_scenario(load_suite(budget.suite))
    if budget.limit is not None and "samples" in STUDIES[name].grid:
        raise InputError(
            f"The study {name!r} chooses the numbers of samples itself: leave out --limit."
        )
    study = STUDIES[name]
    variants = [
        dict(zip(study.grid, values, strict=True))
        for values in itertools.product(*study.grid.values())
    ]
    settings = {"study": name, **vars(budget), "data": scenario.data_hash("train")}
    out.mkdir(parents=True, exist_ok=True)
    with locked(out), termination_interrupts():
        new = _begin(out, settings)
        try:
            # One training a task: a process that is free takes the next, and none is begun twice.
            tables = worker_pool(jobs, batch_size=1)(
                joblib.delayed(_rows)(study, variant, budget, out, progress and jobs == 1)
                for variant in variants
            )
            table: pd.DataFrame = pd.concat(tables, ignore_index=True)
            atomic_write(out / SAMPLES, table.to_parquet())
        except InputError:
            # Where nothing was trained yet, other options may be right.
            if new and not any(out.glob(f"*/{SAMPLES}")):
                (out / "study.json").unlink()
            raise
        except KeyboardInterrupt as stop:
            raise TrainingInterruptedError(
                f"Interrupted: finished trainings and epochs are stored in {out}; the same command "
                "continues."
            ) from stop
    return table


def _begin(out: Path, settings: Mapping[str, Any]) -> bool:
    """Write the settings to `out`, or check that they are those of the study there.

    Returns:
        True if the study is new.
    """
    file = out / "study.json"
    if file.is_file():
        begun = read_json(file)
        for name, value in settings.items():
            if begun.get(name) != value:
                raise InputError(
                    f"{out} holds a study with {name} {begun.get(name)!r}, not {value!r}: choose "
                    "another folder with --out."
                )
        return False
    if any(entry.name != LOCK for entry in out.iterdir()):
        raise InputError(f"{out} is not empty and holds no study: choose another folder.")
    atomic_write_json(file, settings)
    return True


def _rows(
    study: TrainingStudy, variant: Variant, budget: StudyBudget, out: Path, progress: bool
) -> pd.DataFrame:
    """Return the rows of a training; one row without figures if it diverged."""
    folder = out / _label(variant)
    finished = folder / SAMPLES
    if not finished.is_file():
        base = TrainingRequest(
            "phydnn",
            budget.suite,
            epochs=budget.epochs,
            limit=budget.limit,
            operator=budget.operator,
            out=folder,
            install="never",
            progress=progress,
        )
        try:
            table = _train_and_score(study, replace(base, **study.changes(variant)), budget.scored)
        except DivergedError:
            table = pd.DataFrame([{"scenario": ""}])
        atomic_write(finished, table.to_parquet())
        for weights in folder.rglob("*.safetensors"):  # the learning curve stays
            weights.unlink()
    return read_table(finished).assign(**variant)


def _label(variant: Variant) -> str:
    return "-".join(f"{name}-{value}" for name, value in sorted(variant.items()))


def _train_and_score(
    study: TrainingStudy, request: TrainingRequest, limit: int | None
) -> pd.DataFrame:
    """Train and score."""
    training = train(request)
    about = json.loads(training.weights.with_suffix(".json").read_text())
    tables = []
    for scenario, split in _scenarios(study, request.suite):
        data = load(scenario, split, limit)
        method = create(request.name, weights=str(training.weights))
        problem = Problem(data.sensor, data.references[0], no_split)
        method.fit(problem)
        table = evaluate(data, reconstructed(method, problem, data))[["sample", *METRICS]]
        table = table.assign(cluster=data.samples["cluster"], train_s=float(about["train_s"]))
        tables.append(table.assign(scenario=scenario.name))
    return pd.concat(tables, ignore_index=True)


def _scenarios(study: TrainingStudy, suite: str) -> list[tuple[SimulatedScenario, Split]]:
    """Return the scenarios and splits that the trainings of a study are scored on."""
    own = training_scenario(load_suite(suite))
    found: list[tuple[SimulatedScenario, Split]] = [(own, study.split)]
    for name in OTHER_SUITES if study.elsewhere else ():
        found += [
            (scenario, "test")
            for scenario in load_suite(name).scenarios
            if isinstance(scenario, SimulatedScenario)
            and sensor_key(scenario.nominal_sensor) == sensor_key(own.nominal_sensor)
        ]
    return found


def learning_curve(method: str, sensor: Sensor) -> pd.DataFrame:
    """Return the learning curve of the weights that `method` uses for `sensor`, a row per epoch.

    Columns: `epoch`, `train` and `validation` (data loss), `train_physical` and
    `validation_physical` where the training logged them, `rate`, `seconds`.

    Raises:
        InputError: there are no weights, or no curve beside them, or the method learns nothing.
        DataCorruptError: the weights or the curve are damaged.
    """
    cls = methods().get(method)
    if cls is None or not issubclass(cls, TrainedMethod):
        raise InputError(f"{method!r} is no method that is trained.")
    path = cls.files.load(sensor).path.with_suffix(".json")
    if not path.is_file():
        raise InputError(f"There is no learning curve {path} beside the weights of {method!r}.")
    try:
        return pd.DataFrame(json.loads(path.read_text())["curve"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DataCorruptError(
            f"{path} holds no learning curve: train {method!r} again."
        ) from error


def paper_curves() -> dict[str, pd.DataFrame]:
    """Return the learning curves of "dnn" and "phydnn" on the sensor of the paper.

    Raises:
        InputError, DataCorruptError: as `learning_curve`.
    """
    return {name: learning_curve(name, foam16()) for name in ("dnn", "phydnn")}
