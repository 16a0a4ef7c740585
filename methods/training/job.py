"""Steps that every training takes before and after its epochs: data, checkpoint, weights in use."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import torch

from eitbench import __version__
from eitbench.methods.training.checkpoint import Checkpoint
from eitbench.methods.training.loop import fit
from eitbench.methods.training.samples import images, training_scenario
from eitbench.methods.weights.weight_files import sensor_key, user_weights
from eitbench.scenarios.data.simulation import clean_frames
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

    from eitbench.methods.training.loop import Data, TrainingTask
    from eitbench.methods.training.request import Trainable, TrainingRequest
    from eitbench.scenarios.suites.scenario import Split


@dataclass(frozen=True)
class TrainingResult:
    """A finished training.

    Attributes:
        name: of the method or operator.
        weights: the file that is used, or else the one in the training's folder.
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


class TrainingJob:
    """A training of `model` on the data that a request names.

    Attributes:
        request: what is asked for.
        recipe: with the epochs and the seed that are asked for.
        scenario, sensor: what is trained on, and its nominal sensor.
        folder: as requested, by default one in the cache.
        settings: what decides the result beside the recipe: network, sensor and data.

    Raises:
        InputError: no epoch, a suite that cannot be trained on, or no such device.
    """

    def __init__(self, request: TrainingRequest, model: type[Trainable]) -> None:
        self.request, self._files = request, model.files
        epochs = model.recipe.epochs if request.epochs is None else request.epochs
        self.recipe = replace(model.recipe, epochs=epochs, seed=request.seed)
        self._device = training_device(request.device)
        self.scenario = training_scenario(load_suite(request.suite))
        self.sensor = self.scenario.nominal_sensor
        self._file_name = self._files.file_name(self.sensor)
        name = self._file_name.removesuffix(".safetensors")
        self.folder = request.out or cache_dir() / "training" / name
        self.settings: dict[str, object] = {
            "name": self._files.name,
            "network_version": self._files.version,
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

    def check(self, **settings: object) -> None:
        """Add to the settings, and check that `fit` can begin or continue with them.

        To be called before minutes are spent on data.

        Raises:
            InputError: the folder holds a training with other settings.
            DataCorruptError: its checkpoint is damaged.
        """
        self.settings |= settings
        Checkpoint.read(self.folder, self.settings | asdict(self.recipe))

    def clean_samples(self, split: Split, count: int) -> tuple[Tensor, Tensor]:
        """Return conductivities (n, H, W) [S/m], float32, and clean voltages (n, M) [V/A]."""
        request = self.request
        frames = clean_frames(
            self.scenario, split, count, jobs=request.jobs, progress=request.progress
        )
        return images(self.scenario, split, count), torch.from_numpy(frames.voltages)

    def fit(
        self,
        task: TrainingTask,
        train: Data,
        validation: Data,
        baseline: str,
        baseline_mse: float,
        metadata: Mapping[str, str],
        *,
        compared: Data | None = None,
    ) -> TrainingResult:
        """Train a network, write its weights with their learning curve, and put them in use.

        Args:
            task, train, validation, compared: see `loop.fit`.
            baseline, baseline_mse: see `TrainingResult`.
            metadata: of the weights, beside what concerns all trainings.

        Raises:
            TrainingInterruptedError, DivergedError: as for `loop.fit`.
            EitbenchError: a folder is not writable or full.
        """
        state = fit(
            task,
            self.recipe,
            train,
            validation,
            self.folder,
            self.settings,
            compared=compared,
            device=self._device,
            progress=self.request.progress,
        )
        best, on_gpu = state.best_epoch, self._device.type == "cuda"
        metadata = {
            "seed": str(self.request.seed),
            "scenario": self.scenario.name,
            "train_data": str(self.settings["train_data"]),
            "validation_data": str(self.settings["validation_data"]),
            "command": self.request.command(self.recipe.epochs),
            **metadata,
            "epochs": str(len(state.curve)),
            "best_epoch": str(best.epoch),
            "validation_mse": repr(best.validation),
            "device": torch.cuda.get_device_name(self._device) if on_gpu else "cpu",
            "train_s": f"{sum(epoch.seconds for epoch in state.curve):.1f}",
            "eitbench": __version__,
            "torch": torch.__version__,
        }
        path = self.folder / self._file_name
        self._files.save(path, self.sensor, state.best, metadata)
        content = {**metadata, "curve": [epoch.row() for epoch in state.curve]}
        path.with_suffix(".json").write_text(json.dumps(content, indent=1) + "\n")
        if self.request.use:  # a copy where the user's own weights are looked for
            made, path = path, user_weights() / path.name
            for suffix in (".json", path.suffix):
                atomic_write(path.with_suffix(suffix), made.with_suffix(suffix).read_bytes())
        return TrainingResult(
            self.request.name, path, self.request.use, best.validation, baseline, baseline_mse
        )


def training_device(name: str) -> torch.device:
    """The device "cpu" or "cuda"; "auto" is a GPU if there is any.

    Raises:
        InputError: another name, or no GPU.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise unknown_name("device", name, ("auto", "cpu", "cuda"))
    found = torch.cuda.is_available()
    if name == "cuda" and not found:
        raise InputError(
            "torch finds no GPU to train on: use --device cpu, or install a build of torch for "
            "this machine's GPU and driver."
        )
    return torch.device("cuda" if found and name != "cpu" else "cpu")
