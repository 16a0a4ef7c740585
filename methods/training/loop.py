"""The training loop: seeded, kept after every epoch, and the same after an interruption."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING

import torch
from lightning.pytorch import Trainer

from eitbench.methods.training.checkpoint import Checkpoint
from eitbench.methods.training.curve import Trained
from eitbench.methods.training.keeper import Keeper
from eitbench.methods.training.progress import EpochProgress
from eitbench.methods.training.recipe import ONE_DEVICE, Devices
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.seeds import generator

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from eitbench.methods.training.recipe import Recipe
    from eitbench.methods.training.trainee import Data, Trainee


class TrainingInterruptedError(EitbenchError):
    """The training was stopped by the user; finished epochs are kept."""


def fit(
    trainee: Trainee,
    recipe: Recipe,
    train: Data,
    validation: Data,
    folder: Path,
    settings: Mapping[str, object],
    *,
    compared: Data | None = None,
    devices: Devices = ONE_DEVICE,
    progress: bool = False,
) -> Trained:
    """Train by `recipe`, or continue what was begun in `folder`, and keep every epoch there.

    On the CPU, a training that was continued gives the same weights as one that never stopped. The
    network ends with the last epoch's weights; the best ones are returned.

    Args:
        train: tensors with the training samples along their first axis.
        validation: likewise.
        settings: what else decides the result, as plain values: data, initial weights.
        compared: samples that the trainee's validation step sees too, as those of data loader 1.
        devices: to train on; each but the first is given to a copy of this process, which ends
            here.
        progress: show on stderr how far it is.

    Raises:
        InputError: `folder` holds a training with other settings.
        DataCorruptError: what it holds is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        DivergedError: a loss is not finite; the last good state is kept.
        EitbenchError: the folder is not writable or full.
    """
    begun = begun_in(folder, recipe, settings)
    if begun is not None:
        trainee.network.load_state_dict(begun.weights)
    done = 0 if begun is None else len(begun.curve)
    copy = "LOCAL_RANK" in os.environ  # as Lightning starts them
    with EpochProgress(recipe.epochs, quiet=copy or not progress) as bar, _without_noise():
        keeper = Keeper(recipe, folder, {**settings, **asdict(recipe)}, begun, bar)
        trainer = Trainer(
            accelerator=devices.kind,
            devices=devices.count,
            strategy="auto" if devices.count == 1 else "ddp",
            max_epochs=recipe.epochs - done,
            gradient_clip_val=1.0,
            num_sanity_val_steps=0,
            logger=False,
            enable_checkpointing=False,
            enable_progress_bar=False,
            enable_model_summary=False,
            callbacks=[keeper],
        )
        place = trainer.strategy.root_device
        if not recipe.over_after(keeper.curve):
            shuffled = _Batches(
                train,
                recipe.batch,
                place,
                seed=recipe.seed,
                epoch=done,
                rank=trainer.global_rank,
                devices=trainer.world_size,
            )
            watched = [
                _Batches(data, recipe.batch, place)
                for data in (validation, compared)
                if data is not None
            ]
            with _interruption_is_an_error(folder), torch.random.fork_rng():
                trainer.fit(trainee, shuffled, watched)
            if copy:
                raise SystemExit(0)
    weights = {name: tensor.cpu() for name, tensor in keeper.best.items()}
    return Trained(weights, keeper.curve, _name(place))


def begun_in(folder: Path, recipe: Recipe, settings: Mapping[str, object]) -> Checkpoint | None:
    """What `fit` would continue; also a quick way to learn that it cannot.

    Raises:
        InputError, DataCorruptError: as for `fit`.
    """
    return Checkpoint.read(folder, {**settings, **asdict(recipe)})


class _Batches:
    """Batches of samples that stay on the device; a new order each epoch if there is a seed."""

    def __init__(
        self,
        data: Data,
        size: int,
        device: torch.device,
        *,
        seed: int | None = None,
        epoch: int = 0,
        rank: int = 0,
        devices: int = 1,
    ) -> None:
        """This process is given the share number `rank` of every batch, of `devices` shares."""
        self.data = tuple(tensor.to(device) for tensor in data)
        self.size, self.seed, self.epoch = size, seed, epoch
        self.rank, self.devices = rank, devices

    def __len__(self) -> int:
        whole, rest = divmod(len(self.data[0]), self.size)
        return whole + (rest >= self.devices)

    def __iter__(self) -> Iterator[Data]:
        count = len(self.data[0])
        order = torch.arange(count)
        if self.seed is not None:
            rng = generator("training order", self.seed, self.epoch)
            order = torch.from_numpy(rng.permutation(count))
        self.epoch += 1
        parts = torch.split(order.to(self.data[0].device), self.size)
        for part in parts[: len(self)]:
            share = part[self.rank :: self.devices]
            yield tuple(tensor[share] for tensor in self.data)


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
    logs = [logging.getLogger(f"lightning.{part}") for part in ("pytorch", "fabric")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"lightning\.")
            yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)
