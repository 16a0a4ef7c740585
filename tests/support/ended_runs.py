"""Signals that a test sends to the run in its own process."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest


@pytest.fixture
def end_run(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """End the run in this process by a signal, and wait until it has stopped its cells."""
    shutdown, stopped = ThreadPoolExecutor.shutdown, threading.Event()

    def noting(pool: ThreadPoolExecutor, *args: Any, **kwargs: Any) -> None:
        stopped.set()
        shutdown(pool, *args, **kwargs)

    def end(signum: int) -> None:
        stopped.clear()
        os.kill(os.getpid(), signum)
        assert stopped.wait(60)

    monkeypatch.setattr(ThreadPoolExecutor, "shutdown", noting)
    return end
