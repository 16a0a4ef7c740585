"""A training's state after an epoch: all that is needed to go on as if it had never stopped."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from eitbench.methods.training.curve import Epoch
from eitbench.methods.weights.tensor_file import read_tensors, write_tensors
from eitbench.scenarios.errors import DataCorruptError, InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

FILE = "checkpoint.safetensors"


@dataclass(frozen=True)
class Checkpoint:
    """The state of a training between two epochs.

    Attributes:
        weights: of the network.
        best: those after the epoch with the lowest validation loss.
        optimizer: its tensors, named by the parameter's number and the quantity.
        curve: the finished epochs.
    """

    weights: Mapping[str, Tensor]
    best: Mapping[str, Tensor]
    optimizer: Mapping[str, Tensor]
    curve: tuple[Epoch, ...]

    def write(self, folder: Path, settings: Mapping[str, object]) -> None:
        """Replace the checkpoint in `folder`: a reader finds the old one or the new.

        Raises:
            EitbenchError: the folder is not writable or full.
        """
        groups = {"weights": self.weights, "best": self.best, "optimizer": self.optimizer}
        write_tensors(
            folder / FILE,
            {f"{group}/{name}": t for group, named in groups.items() for name, t in named.items()},
            {
                "settings": json.dumps(settings),
                "curve": json.dumps([asdict(epoch) for epoch in self.curve]),
            },
        )

    @classmethod
    def read(cls, folder: Path, settings: Mapping[str, object]) -> Checkpoint | None:
        """The checkpoint in `folder`; None if there is none.

        Raises:
            InputError: the training there was begun with other `settings`.
            DataCorruptError: the file is damaged.
        """
        path = folder / FILE
        again = f"delete {path} to begin again"
        try:
            found = read_tensors(path)
        except DataCorruptError as error:
            raise DataCorruptError(f"{error} To train, {again}.") from error
        if found is None:
            return None
        tensors, about = found
        try:
            begun = json.loads(about["settings"])
            curve = tuple(Epoch(**epoch) for epoch in json.loads(about["curve"]))
            groups: dict[str, dict[str, Tensor]] = {"weights": {}, "best": {}, "optimizer": {}}
            for key, tensor in tensors.items():
                group, name = key.split("/")
                groups[group][name] = tensor
        except (KeyError, TypeError, ValueError) as error:
            raise DataCorruptError(f"{path} is no checkpoint of a training: {again}.") from error
        for name, value in settings.items():
            if begun.get(name) != value:
                raise InputError(
                    f"The training in {folder} was begun with {name} {begun.get(name)!r}, not "
                    f"{value!r}: choose another folder with --out, or {again}."
                )
        return cls(**groups, curve=curve)
