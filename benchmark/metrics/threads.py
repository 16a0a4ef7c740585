"""Work on many images by several threads: NumPy and compiled loops leave the interpreter's lock."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Part = TypeVar("Part")

MOST = 4
"""More threads gain nothing: they wait for each other between two short array operations."""


def for_each(function: Callable[[Part], None], parts: Sequence[Part]) -> None:
    """Call `function` with each of the `parts`, none of which depends on another one."""
    threads = max(1, min(MOST, os.cpu_count() or 1, len(parts)))
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(function, parts))
