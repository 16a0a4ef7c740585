"""Checkpoint of a training after an epoch: all that is needed to continue it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from eitbench.scenarios.errors import DataCorruptError, InputError
from eitbench.scenarios.storage.array_file import read_arrays, write_arrays

if TYPE_CHECKING:
    from pathlib import Path

CHECKPOINT_FILE = "checkpoint.safetensors"

Tensors = Mapping[str, Tensor]


@dataclass(frozen=True)
class Epoch:
    """One line of a learning curve.

    Attributes:
        epoch: its number, from 1.
        train: mean loss over the training samples, while the weights change.
        validation: loss over the validation samples, after it.
        rate: the last learning rate.
        seconds: the time it took [s].
        others: other losses by name.
    """

    epoch: int
    train: float
    validation: float
    rate: float
    seconds: float
    others: Mapping[str, float] = field(default_factory=dict)

    def row(self) -> dict[str, float]:
        """Return all figures by name."""
        figures = asdict(self)
        figures.update(figures.pop("others"))
        return figures


@dataclass(frozen=True)
class Checkpoint:
    """The state of a training between two epochs; empty before the first.

    Attributes:
        weights: of the network.
        best: those after the epoch with the lowest validation loss.
        optimizer: its tensors, named by the parameter's number and the quantity.
        curve: the finished epochs.
    """

    weights: Tensors = field(default_factory=dict)
    best: Tensors = field(default_factory=dict)
    optimizer: Tensors = field(default_factory=dict)
    curve: tuple[Epoch, ...] = ()

    @property
    def best_epoch(self) -> Epoch:
        """The epoch with the lowest validation loss, the first of equals."""
        return min(self.curve, key=lambda epoch: epoch.validation)

    def write(self, folder: Path, settings: Mapping[str, object]) -> None:
        """Replace the checkpoint in `folder`: a reader finds the old one or the new.

        Raises:
            EitbenchError: the folder is not writable or full.
        """
        groups = {"weights": self.weights, "best": self.best, "optimizer": self.optimizer}
        write_arrays(
            folder / CHECKPOINT_FILE,
            {
                f"{group}/{name}": tensor.detach().cpu().numpy()
                for group, named in groups.items()
                for name, tensor in named.items()
            },
            {
                "settings": json.dumps(settings),
                "curve": json.dumps([asdict(epoch) for epoch in self.curve]),
            },
        )

    @classmethod
    def read(cls, folder: Path, settings: Mapping[str, object]) -> Checkpoint:
        """Return the checkpoint in `folder`; an empty one if there is none.

        Raises:
            InputError: the training there was begun with other `settings`.
            DataCorruptError: the file is damaged.
        """
        path = folder / CHECKPOINT_FILE
        remedy = f"delete {path} to begin again"
        try:
            found = read_arrays(path)
        except DataCorruptError as error:
            raise DataCorruptError(f"{error} To train, {remedy}.") from error
        if found is None:
            return cls()
        arrays, metadata = found
        try:
            begun = json.loads(metadata["settings"])
            curve = tuple(Epoch(**epoch) for epoch in json.loads(metadata["curve"]))
            groups: dict[str, dict[str, Tensor]] = {"weights": {}, "best": {}, "optimizer": {}}
            for key, array in arrays.items():
                group, name = key.split("/")
                groups[group][name] = torch.from_numpy(array)
        except (KeyError, TypeError, ValueError) as error:
            raise DataCorruptError(f"{path} is no checkpoint of a training: {remedy}.") from error
        for name, value in settings.items():
            if begun.get(name) != value:
                raise InputError(
                    f"The training in {folder} was begun with {name} {begun.get(name)!r}, not "
                    f"{value!r}: choose another folder with --out, or {remedy}."
                )
        return cls(**groups, curve=curve)


def optimizer_tensors(optimizer: torch.optim.Optimizer) -> dict[str, Tensor]:
    """Return the state of an optimizer as named tensors."""
    state = optimizer.state_dict()["state"]
    return {f"{k}.{name}": value for k, named in state.items() for name, value in named.items()}


def restore_optimizer(optimizer: torch.optim.Optimizer, tensors: Tensors) -> None:
    """Give an optimizer the state that `optimizer_tensors` returned."""
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in tensors.items():
        number, name = key.split(".", 1)
        state.setdefault(int(number), {})[name] = value
    optimizer.load_state_dict({**optimizer.state_dict(), "state": state})
