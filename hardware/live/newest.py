"""A slot between two threads that holds the newest value only."""

import threading
from typing import Generic, TypeVar

T = TypeVar("T")


class Newest(Generic[T]):
    """What is put in replaces what was not yet taken: whoever is slow misses values, not time."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._value: T | None = None

    def put(self, value: T) -> None:
        """Leave `value` for whoever takes next."""
        with self._arrived:
            self._value = value
            self._arrived.notify()

    def take(self, wait_s: float) -> T | None:
        """The newest value, at most once; None if none comes within `wait_s` [s]."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._value is not None, wait_s)
            value, self._value = self._value, None
            return value
