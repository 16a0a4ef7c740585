"""Steps that every training takes before and after its epochs: data, checkpoint, weights in use."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import psutil
import torch

from eitbench import __version__
from eitbench.methods.training.checkpoint import Checkpoint
from eitbench.methods.training.loop import fit, mean_losses
from eitbench.methods.training.request import INSTALL
from eitbench.methods.training.samples import images, training_scenario
from eitbench.methods.weights.weight_files import packaged_weights, sensor_key, user_weights
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.data.simulation import clean_frames, nominal_samples
from eitbench.scenarios.errors import DataCorruptError, InputError, unknown_name
from eitbench.scenarios.storage.atomic_write import atomic_write, atomic_write_json
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.storage.files import writing
from eitbench.scenarios.suites.suite import load_suite

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from torch import Tensor, nn

    from eitbench.methods.training.loop import Data, TrainingTask
    from eitbench.methods.training.request import Trainable, TrainingRequest
    from eitbench.methods.weights.weight_files import WeightFiles, Weights
    from eitbench.scenarios.data.datasets import Dataset
    from eitbench.scenarios.suites.scenario import Split


CONTINUED_RATE = 0.1
"""Highest learning rate of a training that continues weights, relative to that of a new one."""


@dataclass(frozen=True)
class TrainingResult:
    """A finished training.

    Attributes:
        name: of the method or operator.
        weights: the file that is used, or else the one in the training's folder.
        in_use: True if they will be used from now on.
        validation_loss: the least one on the validation split.
        baseline, baseline_loss: what the network began as, and its loss on the same data.
        loss_before: of the weights that were in use before; None if there were none that fit.
    """

    name: str
    weights: Path
    in_use: bool
    validation_loss: float
    baseline: str
    baseline_loss: float
    loss_before: float | None

    @property
    def better(self) -> str:
        """What has a lower validation loss than the new weights; "" if nothing has."""
        rivals = {self.baseline: self.baseline_loss}
        if self.loss_before is not None:
            rivals["the weights in use"] = self.loss_before
        name = min(rivals, key=rivals.__getitem__)
        return name if rivals[name] < self.validation_loss else ""

    def sentences(self) -> list[str]:
        """Return sentences for the user."""
        compared = f"{self.baseline_loss:.3g} of {self.baseline}"
        if self.loss_before is not None:
            compared += f", {self.loss_before:.3g} of the weights in use before"
        sentences = [
            f"Validation loss: {self.validation_loss:.3g} ({compared}).",
            f"Weights: {self.weights}",
        ]
        if self.in_use:
            sentences.append(f"{self.name!r} uses them from now on; delete the file to go back.")
        elif self.better:
            sentences.append(
                f"{self.name!r} does not use them, for {self.better} has a lower loss. The same "
                "command with --install always puts them in use all the same."
            )
        return sentences


class TrainingJob:
    """A training of `model` on the data that a request names.

    Attributes:
        request: what is asked for.
        recipe: with the epochs and the seed that are asked for.
        scenario, sensor: what is trained on, and its nominal sensor.
        folder: as requested, by default one in the cache.
        device: to train on.
        settings: what decides the result beside the recipe: network, sensor and data.
        begun: the weights that it continues; None if it begins with a new network.

    Raises:
        InputError: no epoch, a suite that cannot be trained on, no such device, an impossible power
            of gains, no weights to begin with, or to continue such as were trained on other data.
    """

    def __init__(self, request: TrainingRequest, model: type[Trainable]) -> None:
        self.request, self._files = request, model.files
        epochs = model.recipe.epochs if request.epochs is None else request.epochs
        self.recipe = replace(model.recipe, epochs=epochs, seed=request.seed)
        if request.start == "weights":
            self.recipe = replace(self.recipe, rate=CONTINUED_RATE * self.recipe.rate)
        self.device = training_device(request.device)
        if not 0 <= request.gain_power < float("inf"):
            raise InputError(f"The power of gains is at least 0, got {request.gain_power}.")
        if request.install not in INSTALL:
            raise unknown_name("choice of --install:", request.install, INSTALL)
        self.scenario = training_scenario(load_suite(request.suite), request.scenario)
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
        self.begun = self._begun(model.begins_with)

    def _begun(self, begins_with: WeightFiles | None) -> Weights | None:
        if self.request.start not in ("new", "weights"):
            raise unknown_name("start of a training:", self.request.start, ("new", "weights"))
        if self.request.start == "new":
            if begins_with is None:
                return None
            self.settings["begun_weights"] = begins_with.content_hash(self.sensor)
            return begins_with.load(self.sensor)
        found = self._files.load(self.sensor)
        self.settings["begun_weights"] = self._files.content_hash(self.sensor)
        same = found.metadata.get("train_data") == self.settings["train_data"]
        if found.path.parent == packaged_weights():
            # A later generator gives the data of the same phantoms another hash.
            same = found.metadata.get("scenario") == self.scenario.name
        if not same:
            raise InputError(
                f"{found.path} was trained on other data than those of scenario "
                f"{self.scenario.name!r}: a training continues weights on their own data."
            )
        return found

    def begin(self, network: nn.Module) -> None:
        """Give a new network the weights that the training continues, if it does.

        Raises:
            InputError: they are of another network.
        """
        if self.begun is not None:
            try:
                network.load_state_dict(self.begun.tensors)
            except RuntimeError as error:
                raise InputError(
                    f"{self.begun.path} holds the weights of another network than this training "
                    "has: choose the same --backbone, or begin with a new network."
                ) from error

    def training_count(self, *, more: bool = False) -> int:
        """Return how many training samples are used.

        Args:
            more: they may be more than the scenario declares.

        Raises:
            InputError: too few for an epoch of more than a step, or too many.
        """
        limit, declared, least = self.request.limit, self.scenario.train, 2 * self.recipe.batch
        count = declared if limit is None else limit
        if count > declared and not more:
            raise InputError(
                f"Scenario {self.scenario.name!r} declares {declared} training samples, and this "
                f"training takes no more: give a --limit up to {declared}, or none."
            )
        # Images are there twice for a moment, in float32.
        size = 8 * count * math.prod(self.sensor.image_shape)
        if size > psutil.virtual_memory().total:
            raise InputError(
                f"{count} training samples take {size / 1e9:.0f} GB of memory, more than there is: "
                "give a lower --limit."
            )
        if count < least:
            raise InputError(
                f"{count} training samples are too few: scenario {self.scenario.name!r} declares "
                f"{declared}, and training takes at least {least}: declare more (`train` in the "
                "suite file), or give a higher --limit."
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

    def noiseless(self, count: int) -> Dataset:
        """The first `count` training samples as the boards of their units send them, without noise.

        Networks get theirs anew in every epoch. There may be more than the scenario declares.
        """
        request, noise = self.request, self.scenario.noise.model_copy(update={"train": "clean"})
        scenario = self.scenario.model_copy(update={"noise": noise, "train": count})
        return load(scenario, "train", count, jobs=request.jobs, progress=request.progress)

    def clean_samples(self, split: Split, count: int) -> tuple[Tensor, Tensor]:
        """Return conductivities (n, H, W) [S/m], float32, and clean voltages (n, M) [V/A].

        Raises:
            InputError: they are of other sensors than the nominal one.
        """
        self.check_nominal("learns the physics of the nominal sensor")
        request = self.request
        frames = clean_frames(
            self.scenario, split, count, jobs=request.jobs, progress=request.progress
        )
        return images(self.scenario, split, count), torch.from_numpy(frames.voltages)

    def fresh_samples(self, epoch: int, count: int) -> tuple[Tensor, Tensor]:
        """The same as `clean_samples` of the `count` training samples that follow those of `epoch`
        such sets; they need not be among the declared ones.
        """
        samples = range(epoch * count, (epoch + 1) * count)
        sigma, frames = nominal_samples(self.scenario, samples, jobs=self.request.jobs)
        sigma[:, ~self.sensor.mask] = self.sensor.background
        return torch.from_numpy(sigma), torch.from_numpy(frames)

    def check_gains(self) -> None:
        """Check that training frames have gains, if such are to be taken out of them.

        Raises:
            InputError: they are of the nominal sensor, whose gains are 1.
        """
        if self.request.gain_power and self.scenario.training_imperfections is None:
            raise InputError(
                f"Training frames of scenario {self.scenario.name!r} have no gains to be taken "
                "out: train without --gain-power, or on a scenario with `training_imperfections`."
            )

    def check_nominal(self, reason: str) -> None:
        """Check that training data are of the nominal sensor, which a training needs for `reason`.

        Raises:
            InputError: they are not.
        """
        if self.scenario.training_imperfections is not None:
            raise InputError(
                f"This training {reason}, and training data of scenario {self.scenario.name!r} "
                "have `training_imperfections`: choose a scenario without."
            )

    def fit(
        self,
        task: TrainingTask,
        train: Data,
        validation: Data,
        baseline: str,
        metadata: Mapping[str, str],
        *,
        compared: Data | None = None,
        renewed: Callable[[int], Data] | None = None,
    ) -> TrainingResult:
        """Train a network, write its weights with their learning curve, and put them in use.

        Args:
            task, train, validation, compared, renewed: see `loop.fit`.
            baseline: see `TrainingResult`; what the task's network is now, if it is a new one.
            metadata: of the weights, beside what concerns all trainings; `train_samples` among it.

        Raises:
            TrainingInterruptedError, DivergedError: as for `loop.fit`.
            EitbenchError: a folder is not writable or full.
        """
        baseline = baseline if self.begun is None else "the weights that it continues"
        baseline_loss = self._loss(task, validation)
        loss_before = self._loss_before(task, validation)
        state = fit(
            task,
            self.recipe,
            train,
            validation,
            self.folder,
            self.settings,
            compared=compared,
            renewed=renewed,
            device=self.device,
            progress=self.request.progress,
        )
        seconds = sum(epoch.seconds for epoch in state.curve)
        more = int(metadata["train_samples"]) > self.scenario.train
        metadata = {**metadata, "unlimited": str(int(self.request.unlimited or more))}
        if renewed is not None:
            count = int(metadata["train_samples"]) * len(state.curve)
            metadata = {**metadata, "train_samples": str(count)}
        if self.begun is not None:  # what was learned before was learned, too
            before = self.begun.metadata
            seconds += float(before["train_s"])
            if before["train_data"] == self.settings["train_data"]:
                count = max(int(metadata["train_samples"]), int(before["train_samples"]))
                metadata = {**metadata, "train_samples": str(count)}
            metadata = {
                **metadata,
                "unlimited": max(metadata["unlimited"], before.get("unlimited", "0")),
                "begun_weights": str(self.settings["begun_weights"]),
            }
        best, on_gpu = state.best_epoch, self.device.type == "cuda"
        metadata = {
            "seed": str(self.request.seed),
            "scenario": self.scenario.name,
            "train_data": str(self.settings["train_data"]),
            "validation_data": str(self.settings["validation_data"]),
            "command": self.request.command(self.recipe.epochs),
            **metadata,
            "baseline": baseline,
            "baseline_loss": repr(baseline_loss),
            "epochs": str(len(state.curve)),
            "best_epoch": str(best.epoch),
            "validation_loss": repr(best.validation),
            "device": torch.cuda.get_device_name(self.device) if on_gpu else "cpu",
            "train_s": f"{seconds:.1f}",
            "eitbench": __version__,
            "torch": torch.__version__,
        }
        path = self.folder / self._file_name
        self._files.save(path, self.sensor, state.best, metadata)
        content = {**metadata, "curve": [epoch.row() for epoch in state.curve]}
        with writing(path.parent):
            atomic_write_json(path.with_suffix(".json"), content)
        result = TrainingResult(
            self.request.name, path, False, best.validation, baseline, baseline_loss, loss_before
        )
        install = self.request.install
        if install == "never" or (install == "better" and result.better):
            return result
        used = user_weights() / path.name  # a copy where the user's own are looked for
        with writing(used.parent):
            for suffix in (".json", path.suffix):
                atomic_write(used.with_suffix(suffix), path.with_suffix(suffix).read_bytes())
        return replace(result, weights=used, in_use=True)

    def _loss(self, task: TrainingTask, validation: Data) -> float:
        """The loss of the task's network on the validation samples."""
        task.to(self.device)
        seen = {"validation": tuple(tensor.to(self.device) for tensor in validation)}
        return mean_losses(task, seen, self.recipe.batch)["validation"]

    def _loss_before(self, task: TrainingTask, validation: Data) -> float | None:
        """That of the weights in use; None if there are none that this version could use."""
        try:
            _, tensors, metadata = self._files.load(self.sensor)
        except (InputError, DataCorruptError):
            return None
        if metadata.get("begun_from") != self.settings.get("begun_from"):
            return None
        if float(metadata.get("gain_power", 0.0)) != self.request.gain_power:
            return None  # they take other inputs
        new = task.network
        try:
            with torch.random.fork_rng():  # a new network draws weights, to be replaced
                task.network = task.network_of(metadata)
            task.network.load_state_dict(tensors)
            return self._loss(task, validation)
        except (KeyError, RuntimeError, InputError):  # damaged: they hold something else
            return None
        finally:
            task.network = new


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
