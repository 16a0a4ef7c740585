"""Training hyper-parameters: epochs, batches, learning rates and patience."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from eitbench.methods.training.curve import best
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from eitbench.methods.training.curve import Epoch
    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.methods.weights.weight_files import WeightFiles
    from eitbench.scenarios.sensors.sensor import Sensor

WARM_UP = 0.05
"""Share of all steps in which the learning rate rises."""


@dataclass(frozen=True)
class Recipe:
    """Hyper-parameters of a training.

    Attributes:
        epochs: how often every training sample is seen.
        seed: of the order of samples, and of all else that is random in an epoch.
        batch: samples in a step.
        rate: the highest learning rate; it rises linearly at first, then falls as a cosine.
        patience: epochs without a better validation loss after which the training ends early.

    Raises:
        InputError: no epoch.
    """

    epochs: int
    seed: int = 0
    batch: int = 64
    rate: float = 1e-3
    patience: int | None = None

    def __post_init__(self) -> None:
        if self.epochs < 1:
            raise InputError(f"Training takes at least 1 epoch, got {self.epochs}.")

    def rate_at(self, progress: float) -> float:
        """Return the learning rate after the share `progress` of all steps."""
        if progress < WARM_UP:
            return self.rate * progress / WARM_UP
        return self.rate * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP))) / 2

    def over_after(self, curve: tuple[Epoch, ...]) -> bool:
        """True if `curve` ends a training: all epochs are done, or patience is at its end."""
        if not curve or self.patience is None:
            return len(curve) >= self.epochs
        return len(curve) >= min(self.epochs, best(curve).epoch + self.patience)


class Trainable(ABC):
    """Base of the methods and operators whose networks `eitbench train` trains.

    Attributes:
        files: where weights are looked for.
        recipe: hyper-parameters of the training, unless others are asked for.
        options: those of `TrainingRequest` that its training takes, among `request.OPTIONS`.
    """

    files: ClassVar[WeightFiles]
    recipe: ClassVar[Recipe]
    options: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """SHA-256 (hex) of the weights that it loads for `sensor`; "" if there are none."""
        return cls.files.content_hash(sensor)

    @classmethod
    @abstractmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """Train its networks; see `eitbench.methods.training.train`."""
