"""What a training is asked for."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from eitbench.methods.training.recipe import ONE_DEVICE, Devices
from eitbench.scenarios.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

CHOICES = ("limit", "operator", "beta", "backbone")
"""What not every training takes, and what decides its result."""


@dataclass(frozen=True)
class Request:
    """What to train, and how; the defaults give the weights that are shipped.

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
        devices: to train on.
        jobs: processes to simulate with.
        out: where state and results are kept; a folder in the cache by default.
        use: whether the method is to use the weights from now on.
        progress: show on stderr how far it is.
    """

    name: str
    suite: str
    epochs: int | None = None
    seed: int = 0
    limit: int | None = None
    operator: str = "surrogate"
    beta: float | None = None
    backbone: str = "unet"
    devices: Devices = ONE_DEVICE
    jobs: int = 1
    out: Path | None = None
    use: bool = True
    progress: bool = False

    def command(self, epochs: int) -> str:
        """The command that does the same."""
        words = f"eitbench train {self.name} --suite {self.suite} --epochs {epochs}"
        return f"{words} --seed {self.seed}{self._arguments(CHOICES)}"

    def refuse(self, *choices: str) -> None:
        """Check that none of these `choices` was made.

        Raises:
            InputError: one was.
        """
        if made := self._arguments(choices):
            raise InputError(f"Training of {self.name!r} takes no{made}.")

    def _arguments(self, choices: tuple[str, ...]) -> str:
        """Those of `choices` that differ from the defaults, as arguments of the command."""
        defaults = {field.name: field.default for field in fields(self)}
        made = {name: getattr(self, name) for name in choices}
        return "".join(f" --{name} {v}" for name, v in made.items() if v != defaults[name])
