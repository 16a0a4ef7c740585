"""Progress of a training on stderr: a bar on a terminal, else a line for each epoch."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from eitbench.methods.training.curve import Epoch


class EpochProgress(Progress):
    """Display of finished epochs, last losses and the time left; of nothing if `quiet`."""

    def __init__(self, epochs: int, *, quiet: bool) -> None:
        console = Console(file=sys.stderr, quiet=quiet)
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            disable=quiet or not console.is_terminal,
        )
        self._epochs = epochs
        self._training = self.add_task("training", total=epochs)

    def moved(self, epochs: float) -> None:
        """Show that so many epochs are done."""
        self.update(self._training, completed=epochs)

    def epoch_done(self, epoch: Epoch) -> None:
        """Show an epoch that is done."""
        losses = f"train {epoch.train:.3g}  validation {epoch.validation:.3g}"
        line = f"epoch {epoch.epoch}/{self._epochs}  {losses}"
        self.update(self._training, description=line, completed=epoch.epoch)
        if self.disable:
            self.console.print(f"{line}  {epoch.seconds:.0f} s", markup=False, highlight=False)
