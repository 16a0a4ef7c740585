"""The training loop: seeded, stored after every epoch, and the same after an interruption."""

from __future__ import annotations

import copy
import math
import sys
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import pandas as pd
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor, nn

from eitbench.methods.training.checkpoint import (
    Checkpoint,
    Epoch,
    optimizer_tensors,
    restore_optimizer,
)
from eitbench.methods.training.request import DivergedError, TrainingInterruptedError
from eitbench.scenarios.interrupts import termination_interrupts
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.files import writing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from eitbench.methods.training.request import Recipe

LARGEST_GRADIENT = 1.0
"""Norm to which the gradient of a step is shortened."""

Data = tuple[Tensor, ...]
"""Samples, along the first axis that all tensors have in common."""


class TrainingTask(nn.Module):
    """A network and the losses that it is trained and validated by.

    `training` is true while the network learns, and false in validation. A subclass gives `loss`,
    or `objective` and `losses` if it has several.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def optimizer(self) -> torch.optim.Optimizer:
        """Return Adam with decoupled weight decay; the loop sets its learning rate."""
        return torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4)

    def network_of(self, metadata: Mapping[str, str]) -> nn.Module:
        """Return a network for other weights of the same name, with their `metadata`."""
        del metadata
        return copy.deepcopy(self.network)

    def loss(self, batch: Data) -> Tensor:
        """Return the mean loss () over a batch."""
        raise NotImplementedError

    def objective(self, batch: Data, epochs_done: int) -> tuple[Tensor, Tensor]:
        """Return what is minimised on a batch, and the loss that the curve shows, both ()."""
        loss = self.loss(batch)
        return loss, loss

    def losses(self, batch: Data) -> dict[str, Tensor]:
        """Return losses () of a batch by name; that named "" chooses the best epoch."""
        return {"": self.loss(batch)}


def working_precision(device: str) -> torch.autocast:
    """bfloat16 where a kind of device computes in it; float32 elsewhere.

    Processors without it take 15 times as long. Results of the two differ by rounding, so that one
    seed makes one result on one kind of machine.
    """
    if device == "cuda":
        able = torch.cuda.is_bf16_supported(including_emulation=False)
    else:
        found = torch.cpu.get_capabilities()
        able = bool(found.get("amx_bf16") or found.get("avx512_bf16"))
    return torch.autocast(device, dtype=torch.bfloat16, enabled=able)


def fit(
    task: TrainingTask,
    recipe: Recipe,
    train: Data,
    validation: Data,
    folder: Path,
    settings: Mapping[str, object],
    *,
    compared: Data | None = None,
    renewed: Callable[[int], Data] | None = None,
    device: torch.device | None = None,
    progress: bool = False,
) -> Checkpoint:
    """Train by `recipe`, or continue what was begun in `folder`, with a checkpoint every epoch.

    On the CPU, a training that was continued gives the same weights as one that never stopped.

    Args:
        train: tensors with the training samples along their first axis.
        validation: likewise.
        settings: what else decides the result, as plain values: data, initial weights.
        compared: training samples whose losses are shown beside those of validation, all but the
            first, which is shown of the batches.
        renewed: gives the training samples of every epoch after the first from the number of
            epochs done; by default they are those of the first.
        device: to train on; the CPU by default.
        progress: show the progress on stderr: a bar on a terminal, else a line for each epoch.

    Raises:
        InputError: `folder` holds a training with other settings.
        DataCorruptError: its checkpoint is damaged.
        TrainingInterruptedError: Ctrl-C or SIGTERM; the same call continues.
        DivergedError: a loss is not finite; the last good state is stored.
        EitbenchError: the folder is not writable or full.
    """
    settings = {**settings, **asdict(recipe)}
    state = Checkpoint.read(folder, settings)
    seen = {"validation": validation} | ({} if compared is None else {"train": compared})
    console = Console(file=sys.stderr, quiet=not progress)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    hidden = not (progress and console.is_terminal)
    with Progress(*columns, console=console, disable=hidden) as bar:
        shown = bar.add_task("training", total=recipe.epochs, completed=len(state.curve))
        epochs = _epochs(
            task,
            recipe,
            train,
            renewed,
            seen,
            state,
            device or torch.device("cpu"),
            lambda done: bar.update(shown, completed=done),
        )
        try:
            with termination_interrupts(), torch.random.fork_rng():
                for state in epochs:
                    state.write(folder, settings)
                    rows = [epoch.row() for epoch in state.curve]
                    table = pd.DataFrame(rows).to_csv(index=False)
                    with writing(folder):
                        atomic_write(folder / "curve.csv", table.encode())
                    last = state.curve[-1]
                    line = (
                        f"epoch {last.epoch}/{recipe.epochs}  train {last.train:.3g}  "
                        f"validation {last.validation:.3g}"
                    )
                    bar.update(shown, description=line, completed=last.epoch)
                    if hidden:
                        line += f"  {last.seconds:.0f} s"
                        console.print(line, markup=False, highlight=False)
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
    return state


def _epochs(
    task: TrainingTask,
    recipe: Recipe,
    train: Data,
    renewed: Callable[[int], Data] | None,
    seen: Mapping[str, Data],
    state: Checkpoint,
    device: torch.device,
    moved: Callable[[float], None],
) -> Iterator[Checkpoint]:
    """Yield the state after every epoch that is to follow `state`.

    Args:
        seen: samples by split, whose losses are worked out after every epoch.
        moved: called before every step with the number of epochs done.

    Raises:
        FloatingPointError: a loss is not finite.
    """
    task.to(device)
    if device.type == "cuda":  # what its convolutions are fastest with
        channels_last(task)
    train = tuple(tensor.to(device) for tensor in train)
    seen = {split: tuple(tensor.to(device) for tensor in data) for split, data in seen.items()}
    optimizer = task.optimizer()
    if state.curve:
        task.network.load_state_dict(state.weights)
        restore_optimizer(optimizer, state.optimizer)
    while not _over(recipe, state):
        done, started = len(state.curve), time.perf_counter()
        if done and renewed is not None:
            train = tuple(tensor.to(device) for tensor in renewed(done))
        torch.manual_seed(int(generator("training epoch", recipe.seed, done).integers(2**63)))
        order = generator("training order", recipe.seed, done).permutation(len(train[0]))
        batches = torch.split(torch.from_numpy(order).to(device), recipe.batch)
        total = torch.zeros((), device=device)
        for index, chosen in enumerate(batches):
            progress = done + index / len(batches)
            moved(progress)
            rate = recipe.rate_at(progress / recipe.epochs)
            for group in optimizer.param_groups:
                group["lr"] = rate
            objective, loss = task.objective(tuple(tensor[chosen] for tensor in train), done)
            if device.type == "cpu":  # elsewhere, asking would take time
                _check_finite(float(objective.detach()))
            optimizer.zero_grad()
            objective.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(task.network.parameters(), LARGEST_GRADIENT)
            optimizer.step()
            total = total + loss.detach() * len(chosen)
        losses = mean_losses(task, seen, recipe.batch)
        losses["train"] = float(total / len(order))
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
        state = Checkpoint(weights, state.best, optimizer_tensors(optimizer), curve)
        if state.best_epoch is epoch:
            state = replace(state, best={name: t.clone() for name, t in weights.items()})
        yield state


def channels_last(module: nn.Module) -> None:
    """Lay the kernels of a module's convolutions out with the channels of a place side by side."""
    for parameter in module.parameters():
        if parameter.dim() == 4:  # spectral weights have five dimensions, which cannot be laid so
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)


def _over(recipe: Recipe, state: Checkpoint) -> bool:
    """True if all epochs are done, or patience is at its end."""
    last = recipe.epochs
    if state.curve and recipe.patience is not None:
        last = min(last, state.best_epoch.epoch + recipe.patience)
    return len(state.curve) >= last


def mean_losses(task: TrainingTask, seen: Mapping[str, Data], batch: int) -> dict[str, float]:
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
