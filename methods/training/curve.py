"""Learning curves, and the network that a training ends with."""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

CURVE_FILE = "curve.csv"


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
class FittedNetwork:
    """The network that a training ends with.

    Attributes:
        weights: the network's, after the best epoch, on the CPU.
        curve: all epochs.
        device: what they were trained on.
    """

    weights: dict[str, Tensor]
    curve: tuple[Epoch, ...]
    device: str

    @property
    def best(self) -> Epoch:
        """The epoch with the lowest validation loss."""
        return best(self.curve)

    def metadata(self) -> dict[str, str]:
        """Return the metadata of its weights that concern the training."""
        return {
            "epochs": str(len(self.curve)),
            "best_epoch": str(self.best.epoch),
            "validation_mse": repr(self.best.validation),
            "device": self.device,
        }


def best(curve: tuple[Epoch, ...]) -> Epoch:
    """Return the epoch with the lowest validation loss, the first of equals."""
    return min(curve, key=lambda epoch: epoch.validation)


def write_curve(folder: Path, curve: tuple[Epoch, ...]) -> None:
    """Write the curve as a table (`curve.csv`), one line for an epoch."""
    rows = [epoch.row() for epoch in curve]
    with (folder / CURVE_FILE).open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[-1]))
        table.writeheader()
        table.writerows(rows)
