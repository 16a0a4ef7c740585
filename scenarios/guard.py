"""Closes the test split to code that learns, tunes or reconstructs.

A switch of this process: it keeps a mistake, or a method that helps itself, from what it must not
see. It is no sandbox: a method is code that runs with the user's rights.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from eitbench.scenarios.errors import InputError

_closed = 0


def close_test_split() -> None:
    """Refuse the test split in this process from now on."""
    global _closed
    _closed += 1


@contextmanager
def closed_test_split() -> Iterator[None]:
    """Refuse the test split in this process until the end of the block."""
    global _closed
    close_test_split()
    try:
        yield
    finally:
        _closed -= 1


def is_closed() -> bool:
    """True if the test split is refused in this process."""
    return _closed > 0


def check_open(split: str) -> None:
    """Refuse the test split where it is closed.

    Raises:
        InputError: `split` is "test" and closed.
    """
    if split == "test":
        sys.audit("eitbench.test_split")  # what watches a worker notes it
    if split == "test" and is_closed():
        raise InputError(
            "The test split is closed to methods and to tuning: learn from the train and "
            "validation splits of the problem."
        )
