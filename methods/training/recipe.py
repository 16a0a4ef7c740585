"""How to train: epochs, rates and patience; and what to train on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from eitbench.methods.training.curve import best
from eitbench.scenarios.errors import InputError, unknown_name

if TYPE_CHECKING:
    from eitbench.methods.training.curve import Epoch

WARM_UP = 0.05
"""Share of all steps in which the learning rate rises."""


@dataclass(frozen=True)
class Recipe:
    """How to train.

    Attributes:
        epochs: how often every training sample is seen.
        seed: of the order of samples, and of all else that is random in an epoch.
        batch: samples in a step.
        rate: the highest learning rate; it rises linearly at first, then falls as a cosine.
        patience: epochs without a better validation loss after which it ends early.

    Raises:
        InputError: no epoch.
    """

    epochs: int
    seed: int
    batch: int
    rate: float
    patience: int | None = None

    def __post_init__(self) -> None:
        if self.epochs < 1:
            raise InputError(f"Training takes at least 1 epoch, got {self.epochs}.")

    def rate_at(self, progress: float) -> float:
        """The learning rate after the share `progress` of all steps."""
        if progress < WARM_UP:
            return self.rate * progress / WARM_UP
        return self.rate * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP))) / 2

    def over_after(self, curve: tuple[Epoch, ...]) -> bool:
        """Whether `curve` ends a training: all epochs are done, or patience is at its end."""
        if not curve or self.patience is None:
            return len(curve) >= self.epochs
        return len(curve) >= min(self.epochs, best(curve).epoch + self.patience)


KINDS = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class Devices:
    """What to train on.

    Attributes:
        kind: "cpu", "cuda", or "auto" for GPUs if there are any.
        count: how many; each takes its share of every batch.

    Raises:
        InputError: there are not so many of that kind.
    """

    kind: str = "auto"
    count: int = 1

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise unknown_name("device", self.kind, KINDS)
        found = torch.cuda.device_count() if torch.cuda.is_available() else 0
        if self.kind == "cuda" and not found:
            raise InputError(
                "torch finds no GPU to train on: use --device cpu, or install a build of torch for "
                "this machine's GPU and driver."
            )
        if self.count < 1 or (found and self.kind != "cpu" and self.count > found):
            raise InputError(f"Training on {self.count} devices was asked for; {found} are here.")


ONE_DEVICE = Devices()
