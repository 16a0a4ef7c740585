"""Request for a training, as the command line or a study makes it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from eitbench.scenarios.errors import EitbenchError, InputError, unknown_name

if TYPE_CHECKING:
    from pathlib import Path


class TrainingInterruptedError(EitbenchError):
    """The training was stopped by the user; finished epochs are stored."""

    exit_code = 130


class DivergedError(EitbenchError):
    """A loss is not finite; the state after the last good epoch is stored."""


OPTIONS = ("limit", "operator", "beta", "backbone")
"""Options that not every training takes, and that decide its result."""

KINDS = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class Devices:
    """Devices to train on.

    Attributes:
        kind: "cpu", "cuda", or "auto" for GPUs if there are any.
        count: how many; each takes its share of every batch.

    Raises:
        InputError: there are not so many of that kind.
    """

    kind: str = "auto"
    count: int = 1

    def __post_init__(self) -> None:
        import torch

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


@dataclass(frozen=True)
class TrainingRequest:
    """Request to train a method or an operator; the defaults give the weights that are shipped.

    Attributes:
        name: of the method or operator.
        suite: name, or path of a suite file, whose first scenario with training and validation
            samples is trained on.
        epochs: how often every training sample is seen; by default as published or as shipped.
        seed: of initial weights, order, noise and symmetries.
        limit: training samples to use; all by default.
        operator: forward operator of the physical loss.
        beta: weight of the physical loss beside the data loss; by default the method's own.
        backbone: of the network.
        devices: to train on; one, a GPU if there is any, by default.
        jobs: processes to simulate with.
        out: folder for checkpoint and results; one in the cache by default.
        use: True if the method is to use the weights from now on.
        progress: show the progress on stderr.
    """

    name: str
    suite: str
    epochs: int | None = None
    seed: int = 0
    limit: int | None = None
    operator: str = "surrogate"
    beta: float | None = None
    backbone: str = "unet"
    devices: Devices | None = None
    jobs: int = 1
    out: Path | None = None
    use: bool = True
    progress: bool = False

    def command(self, epochs: int) -> str:
        """Return the command that does the same."""
        words = f"eitbench train {self.name} --suite {self.suite} --epochs {epochs}"
        return f"{words} --seed {self.seed}{self._arguments(OPTIONS)}"

    def check_options(self, allowed: Iterable[str]) -> None:
        """Check that no other of `OPTIONS` than those `allowed` was chosen.

        Raises:
            InputError: one was.
        """
        if chosen := self._arguments([name for name in OPTIONS if name not in allowed]):
            raise InputError(f"Training of {self.name!r} takes no{chosen}.")

    def _arguments(self, options: Iterable[str]) -> str:
        """Return those of `options` that differ from the defaults, as arguments of the command."""
        defaults = {field.name: field.default for field in fields(self)}
        chosen = {name: getattr(self, name) for name in options}
        return "".join(f" --{name} {v}" for name, v in chosen.items() if v != defaults[name])
