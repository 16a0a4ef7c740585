"""The training loop: seeded, kept after every epoch, and the same after an interruption."""

from __future__ import annotations

import logging
import math
import signal
import time
import warnings
from abc import abstractmethod
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor, nn

from eitbench.methods.training.checkpoint import Checkpoint
from eitbench.methods.training.curve import Epoch, Trained, best
from eitbench.methods.training.progress import EpochProgress
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.seeds import generator

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

WARM_UP = 0.05
"""Share of all steps in which the learning rate rises."""

Data = tuple[Tensor, ...]


class TrainingInterruptedError(EitbenchError):
    """The training was stopped by the user; finished epochs are kept."""


@dataclass(frozen=True)
class Recipe:
    """How to train.

    Attributes:
        epochs: how often every training sample is seen.
        seed: of the order of samples, and of all else that is random in an epoch.
        batch: samples in a step.
        rate: the highest learning rate; it rises linearly at first, then falls as a cosine.

    Raises:
        InputError: no epoch.
    """

    epochs: int
    seed: int
    batch: int
    rate: float

    def __post_init__(self) -> None:
        if self.epochs < 1:
            raise InputError(f"Training takes at least 1 epoch, got {self.epochs}.")

    def rate_at(self, progress: float) -> float:
        """The learning rate after the share `progress` of all steps."""
        if progress < WARM_UP:
            return self.rate * progress / WARM_UP
        return self.rate * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP))) / 2


class Trainee(LightningModule):
    """A network, and the loss that is minimised on training and watched on validation samples."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    @abstractmethod
    def loss(self, batch: Data) -> Tensor:
        """Mean loss () over a batch of samples, tensors with a first axis in common."""

    def training_step(self, batch: Data, index: int) -> Tensor:
        """The loss of one batch."""
        loss = self.loss(batch)
        self.log("train", loss, on_step=False, on_epoch=True, batch_size=len(batch[0]))
        return loss

    def validation_step(self, batch: Data, index: int) -> None:
        """Log the loss of one batch."""
        self.log("validation", self.loss(batch), batch_size=len(batch[0]))

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Adam with decoupled weight decay; the loop sets its learning rate."""
        return torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4)


def fit(
    trainee: Trainee,
    recipe: Recipe,
    train: Data,
    validation: Data,
    folder: Path,
    settings: Mapping[str, object],
    *,
    progress: bool = False,
) -> Trained:
    """Train by `recipe`, or continue what was begun in `folder`, and keep every epoch there.

    On the CPU, a training that was continued gives the same weights as one that never stopped. The
    network ends with the last epoch's weights; the best ones are returned.

    Args:
        train: tensors with the training samples along their first axis.
        validation: likewise.
        settings: what else decides the result, as plain values: data, initial weights.
        progress: show on stderr how far it is.

    Raises:
        InputError: `folder` holds a training with other settings.
        DataCorruptError: what it holds is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        EitbenchError: a loss is not finite, or the folder is not writable or full.
    """
    begun = begun_in(folder, recipe, settings)
    if begun is not None:
        trainee.network.load_state_dict(begun.weights)
    done = 0 if begun is None else len(begun.curve)
    with EpochProgress(recipe.epochs, quiet=not progress) as bar, _without_noise():
        keeper = _Keeper(recipe, folder, {**settings, **asdict(recipe)}, begun, bar)
        trainer = Trainer(
            accelerator="auto",
            devices=1,
            max_epochs=recipe.epochs - done,
            gradient_clip_val=1.0,
            num_sanity_val_steps=0,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            callbacks=[keeper],
        )
        device = trainer.strategy.root_device
        if done < recipe.epochs:
            shuffled = _Batches(train, recipe.batch, device, seed=recipe.seed, epoch=done)
            watched = _Batches(validation, recipe.batch, device)
            with _interruption_is_an_error(folder), torch.random.fork_rng():
                trainer.fit(trainee, shuffled, watched)
    weights = {name: tensor.cpu() for name, tensor in keeper.best.items()}
    return Trained(weights, keeper.curve, _name(device))


def begun_in(folder: Path, recipe: Recipe, settings: Mapping[str, object]) -> Checkpoint | None:
    """What `fit` would continue; also a quick way to learn that it cannot.

    Raises:
        InputError, DataCorruptError: as for `fit`.
    """
    return Checkpoint.read(folder, {**settings, **asdict(recipe)})


class _Batches:
    """Batches of samples that stay on the device; a new order each epoch if there is a seed."""

    def __init__(
        self, data: Data, size: int, device: torch.device, seed: int | None = None, epoch: int = 0
    ) -> None:
        self.data = tuple(tensor.to(device) for tensor in data)
        self.size, self.seed, self.epoch = size, seed, epoch

    def __len__(self) -> int:
        return -(-len(self.data[0]) // self.size)

    def __iter__(self) -> Iterator[Data]:
        count = len(self.data[0])
        order = torch.arange(count)
        if self.seed is not None:
            rng = generator("training order", self.seed, self.epoch)
            order = torch.from_numpy(rng.permutation(count))
        self.epoch += 1
        for part in torch.split(order.to(self.data[0].device), self.size):
            yield tuple(tensor[part] for tensor in self.data)


class _Keeper(Callback):
    """Sets seeds and learning rates, and keeps the state after every epoch."""

    def __init__(
        self,
        recipe: Recipe,
        folder: Path,
        settings: Mapping[str, object],
        begun: Checkpoint | None,
        bar: EpochProgress,
    ) -> None:
        self.recipe, self.folder, self.settings, self.bar = recipe, folder, settings, bar
        self.begun = begun
        self.curve = () if begun is None else begun.curve
        self.best: Mapping[str, Tensor] = {} if begun is None else begun.best
        bar.moved(len(self.curve))

    def on_train_start(self, trainer: Trainer, module: LightningModule) -> None:
        if self.begun is not None:
            _restore(trainer.optimizers[0], self.begun.optimizer)

    def on_train_epoch_start(self, trainer: Trainer, module: LightningModule) -> None:
        rng = generator("training epoch", self.recipe.seed, len(self.curve))
        torch.manual_seed(int(rng.integers(2**63)))
        self.started = time.perf_counter()

    def on_train_batch_start(
        self, trainer: Trainer, module: LightningModule, batch: Any, index: int
    ) -> None:
        done = len(self.curve) + index / trainer.num_training_batches
        self.rate = self.recipe.rate_at(done / self.recipe.epochs)
        for group in trainer.optimizers[0].param_groups:
            group["lr"] = self.rate
        self.bar.moved(done)

    def on_train_epoch_end(self, trainer: Trainer, module: LightningModule) -> None:
        assert isinstance(module, Trainee)
        losses = trainer.callback_metrics
        epoch = Epoch(
            epoch=len(self.curve) + 1,
            train=float(losses["train"]),
            validation=float(losses["validation"]),
            rate=self.rate,
            seconds=time.perf_counter() - self.started,
        )
        if not math.isfinite(epoch.train + epoch.validation):
            raise EitbenchError(
                f"The training in {self.folder} failed: the loss of epoch {epoch.epoch} is not "
                "finite."
            )
        self.curve = (*self.curve, epoch)
        weights = module.network.state_dict()
        if best(self.curve) is epoch:
            self.best = {name: tensor.clone() for name, tensor in weights.items()}
        state = _state(trainer.optimizers[0])
        Checkpoint(weights, self.best, state, self.curve).write(self.folder, self.settings)
        self.bar.finished(epoch)


def _state(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    state = optimizer.state_dict()["state"]
    return {f"{k}.{name}": value for k, named in state.items() for name, value in named.items()}


def _restore(optimizer: torch.optim.Optimizer, named: Mapping[str, Tensor]) -> None:
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in named.items():
        number, name = key.split(".", 1)
        state.setdefault(int(number), {})[name] = value
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})


def _name(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return device.type


@contextmanager
def _interruption_is_an_error(folder: Path) -> Iterator[None]:
    """Lightning answers Ctrl-C and SIGTERM with an exit, after which Ctrl-C is ignored."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as stop:
        signal.signal(signal.SIGINT, handler)
        raise TrainingInterruptedError(
            f"Interrupted: finished epochs are kept in {folder}; the same command continues."
        ) from stop


@contextmanager
def _without_noise() -> Iterator[None]:
    """Keep back Lightning's remarks on the machine and on what else one might use."""
    log = logging.getLogger("lightning.pytorch")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"lightning\.")
            yield
    finally:
        log.setLevel(level)
