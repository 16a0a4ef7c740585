"""Ends of processes: SIGTERM and SIGHUP do what Ctrl-C does, workers end with who started them."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import joblib
import psutil


@contextmanager
def termination_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt on the first SIGTERM or SIGHUP, so that what is finished is stored.

    SIGHUP comes when a terminal is closed or a connection breaks. Later signals change nothing: a
    terminal that is closed sends several, and none of them may interrupt the storing. A signal
    that is ignored (nohup) stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may say what a signal does
        return
    terminated = False

    def interrupt(number: int, frame: object) -> None:
        nonlocal terminated
        if not terminated:
            terminated = True
            raise KeyboardInterrupt

    def terminate(number: int, frame: object) -> None:
        signal.raise_signal(signal.SIGTERM)  # a server that ends in its own way knows only this one

    handlers = {signal.SIGTERM: interrupt}
    if hasattr(signal, "SIGHUP"):  # Windows has none
        handlers[signal.SIGHUP] = terminate
    before = {number: signal.getsignal(number) for number in handlers}
    taken = [number for number, handler in before.items() if handler is not signal.SIG_IGN]
    try:
        for number in taken:
            signal.signal(number, handlers[number])
        yield
    finally:
        for number in taken:
            signal.signal(number, before[number])


def worker_pool(jobs: int, **options: Any) -> joblib.Parallel:
    """Return so many worker processes of joblib, which end once this process has gone.

    `options` are those of `joblib.Parallel`.
    """
    return joblib.Parallel(
        n_jobs=jobs, initializer=end_with_parent, initargs=(os.getpid(),), **options
    )


def end_with_parent(pid: int) -> None:
    """End this process, a worker of joblib, once `pid`, which started it, has gone.

    Killed, that one cannot end its workers, which then wait for ever for each other. It may have
    gone before this is called.
    """
    try:
        parent = psutil.Process(pid)
    except psutil.NoSuchProcess:
        os._exit(1)
    if os.getppid() != pid:
        os._exit(1)

    def watch() -> None:
        parent.wait()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
