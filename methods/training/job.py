"""What every training does before and after: find its data, keep weights, put them in use."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench import __version__
from eitbench.methods.weight_files import sensor_key, user_weights
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.scenario import SimulatedScenario
from eitbench.scenarios.simulation import clean_voltages, phantom
from eitbench.scenarios.suites import Suite

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from eitbench.methods.training.curve import Trained
    from eitbench.methods.training.recipe import Recipe
    from eitbench.methods.weight_files import WeightFiles
    from eitbench.scenarios.scenario import Split
    from eitbench.scenarios.sensors import Sensor


def training_scenario(suite: Suite) -> SimulatedScenario:
    """The suite's first simulated scenario with training and validation samples.

    Raises:
        InputError: there is none, or several sensors are simulated.
    """
    simulated = [
        scenario
        for scenario in suite.scenarios
        if isinstance(scenario, SimulatedScenario) and scenario.train and scenario.validation
    ]
    if not simulated:
        raise InputError(
            f"Suite {suite.name!r} has no simulated scenario with training and validation samples."
        )
    others = {sensor_key(s.nominal_sensor): s.nominal_sensor.name for s in simulated}
    if len(others) > 1:
        raise InputError(
            f"Suite {suite.name!r} simulates {len(others)} sensors ({', '.join(others.values())}): "
            "a training is for one, so use a suite for each."
        )
    return simulated[0]


def training_folder(files: WeightFiles, sensor: Sensor, out: Path | None) -> Path:
    """Where a training is kept: `out`, by default a folder in the cache."""
    return out or cache_dir() / "training" / files.file_name(sensor).removesuffix(".safetensors")


def data_settings(files: WeightFiles, scenario: SimulatedScenario) -> dict[str, object]:
    """What decides the result beside the recipe: network, sensor and data."""
    return {
        "name": files.name,
        "network_version": files.version,
        "sensor_key": sensor_key(scenario.nominal_sensor),
        "scenario": scenario.name,
        "train_data": scenario.data_hash("train"),
        "validation_data": scenario.data_hash("validation"),
    }


def clean_samples(
    scenario: SimulatedScenario, split: Split, count: int, *, jobs: int, progress: bool
) -> tuple[Tensor, Tensor]:
    """Conductivities (n, H, W) [S/m] in float32 and clean voltages (n, M) [V/A] in float64."""
    voltages = clean_voltages(scenario, split, count, jobs=jobs, progress=progress)
    return images(scenario, split, count), torch.from_numpy(voltages)


def images(scenario: SimulatedScenario, split: Split, count: int) -> Tensor:
    """Conductivities (n, H, W) [S/m] in float32; the background outside the sensor."""
    sensor = scenario.nominal_sensor
    drawn = np.empty((count, *sensor.image_shape), dtype=np.float32)
    for sample, image in enumerate(drawn):
        image[:] = rasterise(phantom(scenario, split, sample), sensor)
    drawn[:, ~sensor.mask] = sensor.background
    return torch.from_numpy(drawn)


def save_result(
    files: WeightFiles,
    scenario: SimulatedScenario,
    folder: Path,
    recipe: Recipe,
    trained: Trained,
    figures: Mapping[str, str],
) -> Path:
    """Write the weights into `folder` with their learning curve (JSON) beside them.

    Raises:
        EitbenchError: the folder is not writable or full.
    """
    settings = data_settings(files, scenario)
    about = {
        "seed": str(recipe.seed),
        "epochs": str(recipe.epochs),
        "scenario": scenario.name,
        "train_data": str(settings["train_data"]),
        "validation_data": str(settings["validation_data"]),
        "best_epoch": str(trained.best.epoch),
        "validation_mse": repr(trained.best.validation),
        **figures,
        "train_s": f"{trained.seconds:.1f}",
        "device": trained.device,
        "eitbench": __version__,
        "torch": torch.__version__,
    }
    sensor = scenario.nominal_sensor
    weights = folder / files.file_name(sensor)
    files.save(weights, sensor, trained.weights, about)
    curve = [epoch.row() for epoch in trained.curve]
    content = json.dumps({**about, "curve": curve}, indent=1) + "\n"
    weights.with_suffix(".json").write_text(content)
    return weights


def put_in_use(weights: Path) -> Path:
    """Copy weights and learning curve to where the user's own are looked for."""
    used = user_weights() / weights.name
    used.parent.mkdir(parents=True, exist_ok=True)
    for source, target in (
        (weights.with_suffix(".json"), used.with_suffix(".json")),
        (weights, used),
    ):
        partial = target.with_name(f".{target.name}.partial")
        shutil.copyfile(source, partial)
        partial.replace(target)
    return used
