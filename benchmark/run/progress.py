"""Progress of a run on stderr: bars on a terminal, lines elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Advance = Callable[[int], None]
"""Counts so many more frames of one cell."""


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
    def cell(self, name: str, frames: int) -> Iterator[Advance]:
        """Show the cell `name` of so many `frames` being worked on."""
        task = self._bars.add_task(name, total=frames)
        yield partial(self._bars.advance, task)
        self._bars.remove_task(task)
        self._bars.advance(self._all, 1)
        self._finished += 1
        if self._bars.disable:
            self.say(f"[{self._finished}/{self._total}] {name}")

    def say(self, sentence: str) -> None:
        """Print one line."""
        self._console.print(sentence, markup=False, highlight=False, soft_wrap=True)
