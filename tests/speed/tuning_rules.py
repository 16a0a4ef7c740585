"""Loss of each rule of tuning with 16 trials: a coordinate sweep and then TPE, or TPE alone.

Every set of parameters is evaluated once (minutes for each method), so that the loss of a rule is
known: the distance of its choice from the best of all sets. Run by hand, with a folder for the
figures of all sets and a file for the losses:

    python tests/speed/tuning_rules.py runs/rules docs/studies/tuning/rules.csv noser tikhonov
"""

import itertools
import json
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import optuna
import pandas as pd
from optuna.samplers import BaseSampler, TPESampler

from eitbench.benchmark.tuning.selection import TuningBudget
from eitbench.benchmark.tuning.sweep import Point, SearchSpace, SweepSampler, figures
from eitbench.benchmark.tuning.trials import Validation, run_trial
from eitbench.methods import create, methods
from eitbench.scenarios.suites.scenario import Scenario
from eitbench.scenarios.suites.suite import load_suite

SEEDS = 50
TRIALS = TuningBudget().trials
Grid = dict[Point, float]


def search_space(method: str) -> SearchSpace:
    """Return the search space of a built-in method."""
    search, made = methods()[method].search, create(method)
    return SearchSpace.of(search, {name: getattr(made, name) for name in search})


def grid(scenario: Scenario, method: str, space: SearchSpace, folder: Path) -> Grid:
    """The figure of every set of parameters, minus infinity where the method fails."""
    path = folder / f"{scenario.name}--{method}.json"
    if not path.is_file():
        suite = load_suite("quick").model_copy(update={"fit_limit_s": 600.0})
        validation = Validation(scenario, method, None, suite, threading.Event())
        found = []
        for point in itertools.product(*(range(len(v)) for v in space.values.values())):
            result = run_trial(
                optuna.trial.FixedTrial({}), space.parameters(point), [validation], 1e9
            )
            found.append([point, result.figure])
        validation.close()
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found))
    figures_of = json.loads(path.read_text())
    return {tuple(point): -np.inf if f is None else f for point, f in figures_of}


def best_found(space: SearchSpace, evaluated: Grid, sampler: BaseSampler) -> float:
    """The best figure of a study of `TRIALS` trials; what is suggested twice costs a trial."""
    study = optuna.create_study(direction="maximize", sampler=sampler)
    study.enqueue_trial(dict(zip(space.values, space.start, strict=True)))
    for _ in range(min(TRIALS, space.size)):
        trial = study.ask(space.distributions())
        value = evaluated[tuple(trial.params[name] for name in space.values)]
        if np.isfinite(value):
            study.tell(trial, value)
        else:
            study.tell(trial, state=optuna.trial.TrialState.FAIL)
    return max(figures(study, space).values())


def main(folder: Path, out: str, names: list[str]) -> None:
    """Write the losses on both scenarios of `quick`, in units of the figure."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    rows = []
    for name, scenario in itertools.product(names, load_suite("quick").scenarios):
        space = search_space(name)
        evaluated = grid(scenario, name, space, folder)
        best = max(evaluated.values())
        rules: dict[str, Callable[..., BaseSampler]] = {
            "sweep": lambda seed, space=space: SweepSampler(space, str(seed)),
            "tpe": lambda seed: TPESampler(seed=seed, multivariate=True),
            "tpe_after_5": lambda seed: TPESampler(
                seed=seed, multivariate=True, n_startup_trials=5
            ),
        }
        row = {"scenario": scenario.name, "method": name, "sets": space.size, "best": best}
        for rule, sampler in rules.items():
            lost = [best - best_found(space, evaluated, sampler(seed)) for seed in range(SEEDS)]
            row |= {rule: np.mean(lost), f"{rule}_worst": np.max(lost)}
        print(row, flush=True)
        rows.append(row)
    pd.DataFrame(rows).to_csv(out, index=False, float_format="%.5g", lineterminator="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3:])
