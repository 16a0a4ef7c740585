"""How far work has come, on stderr: a bar on a terminal, lines elsewhere."""

import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import track

_Step = TypeVar("_Step")

LINE_SECONDS = 60.0
"""Between two lines where there is no terminal."""


def with_bar(steps: Iterable[_Step], title: str, total: int, *, show: bool) -> Iterable[_Step]:
    """Return `steps`, so many in `total`; stderr says how many are done, by a bar on a terminal."""
    console = Console(stderr=True)
    if not show or not total:
        return steps
    if console.is_terminal:
        return track(steps, title, total=total, console=console)
    return _with_lines(steps, title, total, console)


def _with_lines(
    steps: Iterable[_Step], title: str, total: int, console: Console
) -> Iterator[_Step]:
    """Yield `steps`; of those that take long a line says now and then how many are done."""
    said = time.monotonic()
    for done, step in enumerate(steps, 1):
        yield step
        if time.monotonic() - said >= LINE_SECONDS:
            said = time.monotonic()
            console.print(f"{title}: {done:,} of {total:,}", markup=False, soft_wrap=True)
