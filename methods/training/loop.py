"""The training loop: seeded, stored after every epoch, and the same after an interruption."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.methods.training.checkpoint import (
    Checkpoint,
    optimizer_tensors,
    restore_optimizer,
)
from eitbench.methods.training.curve import Epoch, FittedNetwork, best, write_curve
from eitbench.methods.training.progress import EpochProgress
from eitbench.methods.training.replicas import Replica, replicas
from eitbench.methods.training.request import Devices, DivergedError, TrainingInterruptedError
from eitbench.scenarios.interrupts import termination_interrupts
from eitbench.scenarios.seeds import generator

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from eitbench.methods.training.recipe import Recipe
    from eitbench.methods.training.task import Data, TrainingTask

LARGEST_GRADIENT = 1.0
"""Norm to which the gradient of a step is shortened."""


def fit(
    task: TrainingTask,
    recipe: Recipe,
    train: Data,
    validation: Data,
    folder: Path,
    settings: Mapping[str, object],
    *,
    compared: Data | None = None,
    devices: Devices | None = None,
    progress: bool = False,
) -> FittedNetwork:
    """Train by `recipe`, or continue what was begun in `folder`, with a checkpoint every epoch.

    On the CPU, a training that was continued gives the same weights as one that never stopped.

    Args:
        train: tensors with the training samples along their first axis.
        validation: likewise.
        settings: what else decides the result, as plain values: data, initial weights.
        compared: training samples whose losses are to be compared with those of validation.
        devices: to train on; each but the first is driven by a process of its own.
        progress: show the progress on stderr.

    Raises:
        InputError: `folder` holds a training with other settings.
        DataCorruptError: its checkpoint is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        DivergedError: a loss is not finite; the last good state is stored.
        EitbenchError: the folder is not writable or full.
    """
    devices = devices or Devices()
    state = read_checkpoint(folder, recipe, settings)
    seen = {"validation": validation} | ({} if compared is None else {"train": compared})
    arguments = (task, recipe, train, seen, state)
    with EpochProgress(recipe.epochs, quiet=not progress) as bar:
        bar.moved(len(state.curve))
        try:
            with (
                termination_interrupts(),
                torch.random.fork_rng(),
                replicas(devices, run_epochs, arguments) as replica,
            ):
                for state in run_epochs(*arguments, replica, bar.moved):
                    state.write(folder, {**settings, **asdict(recipe)})
                    write_curve(folder, state.curve)
                    bar.epoch_done(state.curve[-1])
        except KeyboardInterrupt as stop:
            raise TrainingInterruptedError(
                f"Interrupted: finished epochs are stored in {folder}; the same command continues."
            ) from stop
        except FloatingPointError as error:
            done = len(state.curve)
            stored = f"its state after epoch {done} is stored" if done else "nothing was stored"
            raise DivergedError(
                f"The training in {folder} diverged: a loss in epoch {done + 1} is not finite; "
                f"{stored}."
            ) from error
    weights = {name: tensor.cpu() for name, tensor in state.best.items()}
    return FittedNetwork(weights, state.curve, replica.device_name)


def read_checkpoint(folder: Path, recipe: Recipe, settings: Mapping[str, object]) -> Checkpoint:
    """Return what `fit` would continue; also a quick way to learn that it cannot.

    Raises:
        InputError, DataCorruptError: as for `fit`.
    """
    return Checkpoint.read(folder, {**settings, **asdict(recipe)})


def run_epochs(
    task: TrainingTask,
    recipe: Recipe,
    train: Data,
    seen: Mapping[str, Data],
    state: Checkpoint,
    replica: Replica,
    moved: Callable[[float], None],
) -> Iterator[Checkpoint]:
    """Yield the state after every epoch that is to follow `state`.

    Args:
        seen: samples by split, whose losses are worked out after every epoch.
        replica: the device, and this process's share of every batch.
        moved: called before every step with the number of epochs done.

    Raises:
        FloatingPointError: a loss is not finite.
    """
    device = replica.device
    task.to(device)
    train = tuple(tensor.to(device) for tensor in train)
    seen = {split: tuple(tensor.to(device) for tensor in data) for split, data in seen.items()}
    optimizer = task.optimizer()
    if state.curve:
        task.network.load_state_dict(state.weights)
        restore_optimizer(optimizer, state.optimizer)
    parameters = list(task.network.parameters())
    while not recipe.over_after(state.curve):
        done, started = len(state.curve), time.perf_counter()
        torch.manual_seed(replica.seed(generator("training epoch", recipe.seed, done)))
        order = generator("training order", recipe.seed, done).permutation(len(train[0]))
        batches = replica.shares(torch.from_numpy(order).to(device), recipe.batch)
        total, count = torch.zeros((), device=device), 0
        for index, chosen in enumerate(batches):
            progress = done + index / len(batches)
            moved(progress)
            rate = recipe.rate_at(progress / recipe.epochs)
            for group in optimizer.param_groups:
                group["lr"] = rate
            objective, loss = task.objective(tuple(tensor[chosen] for tensor in train), done)
            if replica.count == 1 and device.type == "cpu":  # elsewhere, asking would take time
                _check_finite(float(objective.detach()))
            optimizer.zero_grad()
            objective.backward()  # type: ignore[no-untyped-call]
            replica.average_gradients(parameters)
            torch.nn.utils.clip_grad_norm_(parameters, LARGEST_GRADIENT)
            optimizer.step()
            total, count = total + loss.detach() * len(chosen), count + len(chosen)
        losses = _mean_losses(task, seen, recipe.batch)
        losses["train"] = replica.mean(total, count)
        _check_finite(*losses.values())
        epoch = Epoch(
            epoch=done + 1,
            train=losses.pop("train"),
            validation=losses.pop("validation"),
            rate=rate,
            seconds=time.perf_counter() - started,
            others=losses,
        )
        curve, weights = (*state.curve, epoch), task.network.state_dict()
        best_weights = state.best
        if best(curve) is epoch:
            best_weights = {name: tensor.clone() for name, tensor in weights.items()}
        state = Checkpoint(weights, best_weights, optimizer_tensors(optimizer), curve)
        yield state


def _mean_losses(task: TrainingTask, seen: Mapping[str, Data], batch: int) -> dict[str, float]:
    """Return the mean losses over the samples of each split, by split and name of the loss."""
    losses = {}
    task.eval()
    with torch.no_grad():  # operators may store tensors that are differentiated later
        for split, data in seen.items():
            totals: dict[str, Tensor] = {}
            for first in range(0, len(data[0]), batch):
                part = tuple(tensor[first : first + batch] for tensor in data)
                for name, loss in task.losses(part).items():
                    totals[name] = totals.get(name, 0) + loss * len(part[0])
            for name, total in totals.items():
                losses[f"{split}_{name}" if name else split] = float(total / len(data[0]))
    task.train()
    return losses


def _check_finite(*losses: float) -> None:
    if not all(map(math.isfinite, losses)):
        raise FloatingPointError
