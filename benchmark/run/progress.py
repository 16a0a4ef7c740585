"""Progress of a run on stderr: bars on a terminal, lines elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class Bar(Protocol):
    """Counts the frames of one cell."""

    def advance(self, frames: int) -> None:
        """Count `frames` more."""


class CellProgress:
    """The bar of one cell."""

    def __init__(self, bars: Progress, description: str, total: int) -> None:
        self._bars = bars
        self._task = bars.add_task(description, total=total)

    def advance(self, frames: int) -> None:
        """Count `frames` more."""
        self._bars.advance(self._task, frames)


class RunProgress:
    """Bars for the cells of a run; without a terminal, one line for each finished cell."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._console = Console(file=sys.stderr, quiet=quiet)
        self.quiet = quiet
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
        )

    @contextmanager
    def cells(self, total: int) -> Iterator[None]:
        """Show `total` cells being worked on."""
        self._total, self._finished = total, 0
        with self._bars:
            self._all = self._bars.add_task("cells", total=total)
            yield

    @contextmanager
    def cell(self, name: str, frames: int) -> Iterator[CellProgress]:
        """Show the cell `name` of so many `frames` being worked on."""
        bar = CellProgress(self._bars, name, frames)
        yield bar
        self._bars.remove_task(bar._task)
        self._bars.advance(self._all, 1)
        self._finished += 1
        if self._bars.disable:
            self.say(f"[{self._finished}/{self._total}] {name}")

    def say(self, sentence: str) -> None:
        """Print one line."""
        self._console.print(sentence, markup=False, highlight=False, soft_wrap=True)
