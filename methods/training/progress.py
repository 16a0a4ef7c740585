"""Progress of a training on stderr: a bar on a terminal, else a line for each epoch."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from types import TracebackType

    from eitbench.methods.training.curve import Epoch


class EpochProgress:
    """Display of finished epochs, last losses and the time left; of nothing if `quiet`."""

    def __init__(self, epochs: int, *, quiet: bool) -> None:
        self._epochs = epochs
        self._console = Console(file=sys.stderr, quiet=quiet)
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("training", total=epochs)

    def __enter__(self) -> Self:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Leave the bar as it is."""
        self._bar.stop()

    def moved(self, epochs: float) -> None:
        """Show that so many epochs are done."""
        self._bar.update(self._task, completed=epochs)

    def finished(self, epoch: Epoch) -> None:
        """Show an epoch that is done."""
        losses = f"train {epoch.train:.3g}  validation {epoch.validation:.3g}"
        line = f"epoch {epoch.epoch}/{self._epochs}  {losses}"
        self._bar.update(self._task, description=line, completed=epoch.epoch)
        if self._bar.disable:
            self._console.print(f"{line}  {epoch.seconds:.0f} s", markup=False, highlight=False)
