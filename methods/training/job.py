"""What every training does before and after: find its data, keep weights, put them in use."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from eitbench import __version__
from eitbench.methods.weights.weight_files import sensor_key, user_weights
from eitbench.scenarios.atomic_write import atomic_write
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.data.simulation import clean_voltages, phantom
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.phantoms.phantom import rasterise
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import Suite

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from eitbench.methods.training.curve import Epoch
    from eitbench.methods.training.request import Request
    from eitbench.methods.weights.weight_files import WeightFiles
    from eitbench.scenarios.data.datasets import Dataset
    from eitbench.scenarios.sensors.sensor import Sensor
    from eitbench.scenarios.suites.scenario import Split


@dataclass(frozen=True)
class Training:
    """A finished training.

    Attributes:
        name: of the method or operator.
        weights: the file of weights.
        in_use: whether they will be used from now on.
        validation_mse: mean squared error on the validation split.
        baseline, baseline_mse: what to compare it with, and its error.
    """

    name: str
    weights: Path
    in_use: bool
    validation_mse: float
    baseline: str
    baseline_mse: float

    def sentences(self) -> list[str]:
        """What to tell the user."""
        ratio = self.baseline_mse / self.validation_mse
        beside = f"{ratio:.3g} times below" if ratio >= 1 else "not below"
        said = [
            f"Validation MSE: {self.validation_mse:.3g}, {beside} the "
            f"{self.baseline_mse:.3g} of {self.baseline}.",
            f"Weights: {self.weights}",
        ]
        if self.in_use:
            said.append(f"{self.name!r} uses them from now on; delete the file to go back.")
        return said


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


def training_count(request: Request, scenario: SimulatedScenario, least: int) -> int:
    """How many training samples are used.

    Raises:
        InputError: fewer than `least`.
    """
    count = scenario.train if request.limit is None else min(request.limit, scenario.train)
    if count < least:
        raise InputError(
            f"{count} training samples are too few: scenario {scenario.name!r} declares "
            f"{scenario.train}, and training takes at least {least}."
        )
    return count


def no_split(split: str, limit: int | None) -> Dataset:
    """What the problem of a training answers: the training reads its data itself."""
    raise RuntimeError(f"Training reads the {split} split itself.")


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


def finish(
    request: Request,
    files: WeightFiles,
    scenario: SimulatedScenario,
    weights: Mapping[str, Tensor],
    curve: Sequence[Epoch],
    about: Mapping[str, str],
) -> Path:
    """Write the weights with their learning curve (JSON) beside them, and put them in use.

    Returns the file that is used, or else the one in the training's folder.

    Raises:
        EitbenchError: a folder is not writable or full.
    """
    sensor = scenario.nominal_sensor
    settings = data_settings(files, scenario)
    about = {
        "seed": str(request.seed),
        "scenario": scenario.name,
        "train_data": str(settings["train_data"]),
        "validation_data": str(settings["validation_data"]),
        **about,
        "train_s": f"{sum(epoch.seconds for epoch in curve):.1f}",
        "eitbench": __version__,
        "torch": torch.__version__,
    }
    path = training_folder(files, sensor, request.out) / files.file_name(sensor)
    files.save(path, sensor, weights, about)
    content = json.dumps({**about, "curve": [epoch.row() for epoch in curve]}, indent=1) + "\n"
    path.with_suffix(".json").write_text(content)
    return _put_in_use(path) if request.use else path


def _put_in_use(weights: Path) -> Path:
    """Copy weights and learning curve to where the user's own are looked for."""
    used = user_weights() / weights.name
    for source, target in (
        (weights.with_suffix(".json"), used.with_suffix(".json")),
        (weights, used),
    ):
        atomic_write(target, source.read_bytes())
    return used
