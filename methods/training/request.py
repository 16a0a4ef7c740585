"""What is trained and how: the request of a user, and what a method declares of its training."""

from __future__ import annotations

import math
import shlex
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from eitbench.scenarios.errors import EitbenchError, InputError

if TYPE_CHECKING:
    from pathlib import Path

    from eitbench.methods.training.job import TrainingJob, TrainingResult
    from eitbench.methods.weights.weight_files import WeightFiles
    from eitbench.scenarios.sensors.sensor import Sensor


class TrainingInterruptedError(EitbenchError):
    """The training was stopped by the user; finished epochs are stored."""

    exit_code = 130


class DivergedError(EitbenchError):
    """A loss is not finite; the state after the last good epoch is stored."""


OPTIONS = (
    "limit", "unlimited", "start", "loss", "operator", "alpha", "beta", "backbone", "gain_power"
)  # fmt: skip
"""Options that not every training takes, and that decide its result."""

INSTALL = ("better", "always", "never")
"""When new weights are put in use: if they are no worse on validation data than those in use and
than the network before its first step, or whatever they are."""


@dataclass(frozen=True)
class TrainingRequest:
    """Request to train a method or an operator.

    The card beside each file of packaged weights has the command that made it.

    Attributes:
        name: of the method or operator.
        suite: name, or path of a suite file.
        scenario: of the suite, to train on; by default its first with training and validation
            samples.
        epochs: how often every training sample is seen; by default those of the method.
        seed: of initial weights, order, noise and symmetries.
        limit: training samples to use; all that the scenario declares by default. Trainings on
            images draw more if they are more, but not that of `tank-unet`.
        unlimited: True for new training samples in every epoch, as many as `limit` or the scenario
            says; the first epoch has the declared ones.
        start: "new" for a network that begins as its baseline, or "weights" to begin with the
            weights in use.
        loss: "mse", the mean squared error, or "log-mse", the mean over images of its logarithm,
            which is what the mean PSNR averages.
        operator: forward operator of the physical loss; by default the surrogate, where that loss
            is minimised.
        alpha: weight of the data loss, 1 or 0. With 0 no true image is learned from.
        beta: weight of the physical loss beside the data loss; by default the method's own.
        backbone: of the network; by default the method's own.
        gain_power: of the gains of measurements that are taken out of training frames, see
            `Problem`.
        device: "cpu", "cuda", or "auto" for a GPU if there is any.
        jobs: processes to simulate with.
        out: folder for checkpoint and results; one in the cache by default.
        install: one of `INSTALL`.
        progress: show the progress on stderr.
    """

    name: str
    suite: str
    scenario: str | None = None
    epochs: int | None = None
    seed: int = 0
    limit: int | None = None
    unlimited: bool = False
    start: str = "new"
    loss: str = "mse"
    operator: str | None = None
    alpha: float = 1.0
    beta: float | None = None
    backbone: str | None = None
    gain_power: float = 0.0
    device: str = "auto"
    jobs: int = 1
    out: Path | None = None
    install: str = "better"
    progress: bool = False

    def command(self, epochs: int) -> str:
        """Return the command that does the same."""
        words = f"eitbench train {self.name} --suite {shlex.quote(str(self.suite))}"
        words += self._arguments(("scenario",))
        return f"{words} --epochs {epochs} --seed {self.seed}{self._arguments(OPTIONS)}"

    def check_options(self, allowed: Iterable[str]) -> None:
        """Check that no other of `OPTIONS` than those `allowed` was chosen.

        Raises:
            InputError: one was.
        """
        if chosen := self._arguments([name for name in OPTIONS if name not in allowed]):
            raise InputError(f"Training of {self.name!r} takes no{chosen}.")

    def _arguments(self, options: Iterable[str]) -> str:
        """Those of `options` that differ from the defaults, as arguments of the command."""
        defaults = {field.name: field.default for field in fields(self)}
        chosen = {name: getattr(self, name) for name in options}
        return "".join(
            f" --{name.replace('_', '-')}"
            + ("" if value is True else f" {shlex.quote(str(value))}")
            for name, value in chosen.items()
            if value != defaults[name]
        )


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


class Trainable(ABC):
    """Base of the methods and operators whose networks `eitbench train` trains.

    Attributes:
        files: where weights are looked for.
        recipe: hyper-parameters of the training, unless others are asked for.
        begins_with: weights of another name that its network begins with; None for a new network.
        options: those of `OPTIONS` that its training takes.
    """

    files: ClassVar[WeightFiles]
    recipe: ClassVar[Recipe]
    begins_with: ClassVar[WeightFiles | None] = None
    options: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def weights_hash(cls, sensor: Sensor) -> str:
        """SHA-256 (hex) of the weights that it loads for `sensor`; "" if there are none."""
        return cls.files.content_hash(sensor)

    @classmethod
    @abstractmethod
    def train(cls, job: TrainingJob) -> TrainingResult:
        """Train its networks; see `eitbench.methods.training.train`."""
