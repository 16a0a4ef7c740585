"""What a method was told, as it was measured, and whether it was taught on what it is tested on."""

import json
from collections.abc import Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from eitbench.benchmark.tuning.selection import validation_scenario
from eitbench.methods.problem import AccessRecord
from eitbench.methods.weights.weight_files import packaged_weights
from eitbench.scenarios.atomic_write import atomic_write
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.data.datasets import Dataset
from eitbench.scenarios.data.simulation import phantom
from eitbench.scenarios.phantoms.contents import Contents, contents
from eitbench.scenarios.suites.scenario import Scenario, SimulatedScenario
from eitbench.scenarios.suites.suite import learned_from, scenarios

NAN = float("nan")


def account(
    access: AccessRecord,
    trained_on: Mapping[str, str],
    scenario: Scenario,
    test: Dataset,
    *,
    spent: Mapping[str, Any],
) -> dict[str, Any]:
    """What a method was told, in the columns of its cell.

    `prior_knowledge` is JSON: whether it read the `model` with its contact impedance, the `gain`
    and the `conductivity_range`; `given`, the samples it learned from; `trained_on`, those behind
    its weights; `tuned`, what tuning its parameters cost; `noise`, through which of these it knows
    the noise level of the test split. `overlap` is the number of test samples among those it
    learned from, NaN where the data behind its weights are not known here.

    Args:
        access: what it read of its problem.
        trained_on: see `Method`.
        scenario, test: what it is tested on.
        spent: what choosing its parameters on validation data cost; empty where they were not.
    """
    learned = [given.contents for given in access.samples]
    noise = [given.split for given in access.samples if _has_test_noise(scenario, given.split)]
    source = None
    if trained_on:
        source = _source(trained_on, scenario)
        if source is not None:
            learned.append(training_contents(source, int(trained_on["train_samples"])))
    if spent and _has_test_noise(validation_scenario(scenario), "validation"):
        noise.append("tuning")
    shown = contents(test.phantoms, test.voltages)
    overlap = float(np.isin(shown, np.concatenate(learned)).sum()) if learned else 0.0
    told = {
        "model": access.model,
        "gain": access.gain,
        "conductivity_range": access.conductivity_range,
        "given": [
            {
                "split": given.split,
                "scenario": given.scenario,
                "samples": given.samples,
                "data_hash": given.data_hash,
            }
            for given in access.samples
        ],
        "trained_on": dict(trained_on),
        "tuned": dict(spent),
        "noise": noise,
    }
    known = not trained_on or source is not None
    return {"prior_knowledge": json.dumps(told), "overlap": overlap if known or overlap else NAN}


def training_contents(scenario: SimulatedScenario, count: int) -> Contents:
    """What the first `count` training samples show: packaged, or found out once and cached."""
    name = f"contents-{scenario.data_hash('train')[:16]}-{count}.npy"
    kept = cache_dir() / "contents" / name
    for path in (packaged_weights() / name, kept):
        if path.is_file():
            with suppress(ValueError, EOFError):  # one that is damaged is made again
                return _checked(path, count)
    drawn = tuple(phantom(scenario, "train", sample) for sample in range(count))
    found = np.sort(contents(drawn, None))
    with suppress(OSError):  # the next run would only have to do it again
        write_contents(kept, found)
    return found


def write_contents(path: Path, found: Contents) -> None:
    """Write what `training_contents` reads; it appears whole or not at all."""
    buffer = BytesIO()
    np.save(buffer, found)
    atomic_write(path, buffer.getvalue())


def _checked(path: Path, count: int) -> Contents:
    found: Contents = np.load(path, allow_pickle=False)
    if found.shape != (count,) or found.dtype != np.uint64:
        raise ValueError
    return found


def _source(trained_on: Mapping[str, str], scenario: Scenario) -> SimulatedScenario | None:
    """The scenario that weights were trained on, if it is one of ours or the one of the run."""
    named = scenarios().get(trained_on["scenario"])
    for source in (named, scenario, learned_from(scenario)):
        if (
            isinstance(source, SimulatedScenario)
            and source.data_hash("train") == trained_on["train_data"]
        ):
            return source
    return None


def _has_test_noise(scenario: Scenario, split: str) -> bool:
    """Whether data of `split` show the noise of the test split."""
    if isinstance(scenario, SimulatedScenario):
        noise = scenario.noise
        return bool(getattr(noise, split) == noise.test)
    return split == "validation"  # the same board; what is learned of it is simulated
