"""Steps that every training takes before and after its epochs: data, checkpoint, weights in use."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import torch

from eitbench import __version__
from eitbench.methods.training.loop import fit, read_checkpoint
from eitbench.methods.training.samples import training_scenario
from eitbench.methods.weights.weight_files import sensor_key, user_weights
from eitbench.scenarios.atomic_write import atomic_write
from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from torch import Tensor

    from eitbench.methods.training.curve import Epoch, FittedNetwork
    from eitbench.methods.training.recipe import Recipe, Trainable
    from eitbench.methods.training.request import TrainingRequest
    from eitbench.methods.training.task import Data, TrainingTask
    from eitbench.methods.weights.weight_files import WeightFiles
    from eitbench.scenarios.sensors.sensor import Sensor
    from eitbench.scenarios.suites.scenario import SimulatedScenario


@dataclass(frozen=True)
class TrainingResult:
    """A finished training.

    Attributes:
        name: of the method or operator.
        weights: the file of weights.
        in_use: True if they will be used from now on.
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
        """Return sentences for the user."""
        ratio = self.baseline_mse / self.validation_mse
        beside = f"{ratio:.3g} times below" if ratio >= 1 else "not below"
        sentences = [
            f"Validation MSE: {self.validation_mse:.3g}, {beside} the "
            f"{self.baseline_mse:.3g} of {self.baseline}.",
            f"Weights: {self.weights}",
        ]
        if self.in_use:
            sentences.append(f"{self.name!r} uses them from now on; delete the file to go back.")
        return sentences


@dataclass(frozen=True)
class TrainingJob:
    """A training on the data that its request names.

    Attributes:
        files: of the weights.
        recipe: with the epochs and the seed that are asked for.
    """

    request: TrainingRequest
    files: WeightFiles
    recipe: Recipe
    scenario: SimulatedScenario

    @classmethod
    def of(cls, request: TrainingRequest, model: type[Trainable]) -> TrainingJob:
        """Return the job of training `model` as requested.

        Raises:
            InputError: no epoch, or a suite that cannot be trained on.
        """
        epochs = model.recipe.epochs if request.epochs is None else request.epochs
        recipe = replace(model.recipe, epochs=epochs, seed=request.seed)
        return cls(request, model.files, recipe, training_scenario(load_suite(request.suite)))

    @property
    def sensor(self) -> Sensor:
        """The nominal sensor."""
        return self.scenario.nominal_sensor

    @property
    def folder(self) -> Path:
        """The folder of the training: as requested, by default one in the cache."""
        name = self.files.file_name(self.sensor).removesuffix(".safetensors")
        return self.request.out or cache_dir() / "training" / name

    @cached_property
    def settings(self) -> dict[str, object]:
        """Settings that decide the result beside the recipe: network, sensor and data."""
        return {
            "name": self.files.name,
            "network_version": self.files.version,
            "sensor_key": sensor_key(self.sensor),
            "scenario": self.scenario.name,
            "train_data": self.scenario.data_hash("train"),
            "validation_data": self.scenario.data_hash("validation"),
        }

    def training_count(self) -> int:
        """Return how many training samples are used.

        Raises:
            InputError: too few for an epoch of more than a step.
        """
        limit, declared, least = self.request.limit, self.scenario.train, 2 * self.recipe.batch
        count = declared if limit is None else min(limit, declared)
        if count < least:
            raise InputError(
                f"{count} training samples are too few: scenario {self.scenario.name!r} declares "
                f"{declared}, and training takes at least {least}."
            )
        return count

    def check(self, settings: Mapping[str, object], step: str = "") -> None:
        """Check that `fit` can begin or continue, before minutes are spent on data.

        Raises:
            InputError: the folder holds a training with other settings.
            DataCorruptError: its checkpoint is damaged.
        """
        read_checkpoint(self.folder / step, self.recipe, self.settings | dict(settings))

    def fit(
        self,
        task: TrainingTask,
        train: Data,
        validation: Data,
        settings: Mapping[str, object],
        *,
        compared: Data | None = None,
        step: str = "",
    ) -> FittedNetwork:
        """Train a network, in the sub-folder `step`; see `loop.fit`.

        `settings` decide the result beside those of the job.
        """
        return fit(
            task,
            self.recipe,
            train,
            validation,
            self.folder / step,
            self.settings | dict(settings),
            compared=compared,
            devices=self.request.devices,
            progress=self.request.progress,
        )

    def finish(
        self,
        fitted: FittedNetwork,
        metadata: Mapping[str, str],
        baseline: str,
        baseline_mse: float,
        *,
        weights: Mapping[str, Tensor] | None = None,
        curve: Sequence[Epoch] | None = None,
    ) -> TrainingResult:
        """Write the weights with their learning curve (JSON) beside them, and put them in use.

        The file in the result is the one that is used, or else the one in the training's folder.

        Args:
            fitted: the network, the last one if there are several.
            metadata: of the weights, beside what concerns all trainings.
            baseline, baseline_mse: see `TrainingResult`.
            weights, curve: of all networks, if there are several.

        Raises:
            EitbenchError: a folder is not writable or full.
        """
        curve = fitted.curve if curve is None else curve
        metadata = {
            "seed": str(self.request.seed),
            "scenario": self.scenario.name,
            "train_data": str(self.settings["train_data"]),
            "validation_data": str(self.settings["validation_data"]),
            "command": self.request.command(self.recipe.epochs),
            **metadata,
            **fitted.metadata(),
            "train_s": f"{sum(epoch.seconds for epoch in curve):.1f}",
            "eitbench": __version__,
            "torch": torch.__version__,
        }
        path = self.folder / self.files.file_name(self.sensor)
        self.files.save(path, self.sensor, weights or fitted.weights, metadata)
        content = {**metadata, "curve": [epoch.row() for epoch in curve]}
        path.with_suffix(".json").write_text(json.dumps(content, indent=1) + "\n")
        return TrainingResult(
            self.request.name,
            _put_in_use(path) if self.request.use else path,
            self.request.use,
            fitted.best.validation,
            baseline,
            baseline_mse,
        )


def _put_in_use(weights: Path) -> Path:
    """Copy weights and learning curve to where the user's own are looked for."""
    used = user_weights() / weights.name
    for suffix in (".json", used.suffix):
        atomic_write(used.with_suffix(suffix), weights.with_suffix(suffix).read_bytes())
    return used
