"""Ends of processes: SIGTERM does what Ctrl-C does, and workers end with who started them."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import psutil


@contextmanager
def termination_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM, so that what is finished is stored and workers end."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may say what a signal does
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def end_with_parent() -> None:
    """End this process, a worker of joblib, once the one that started it has gone.

    Killed, that one cannot end its workers, which then wait for ever for each other.
    """
    parent = psutil.Process(os.getppid())

    def watch() -> None:
        parent.wait()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
