"""Worker processes: started from one server, on one thread, undisturbed by the terminal."""

import ctypes
import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import psutil
from threadpoolctl import threadpool_limits

from eitbench.benchmark.workers.confinement import Confinement

THREADS = 1
LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMBA")
PINNED = {f"{library}_NUM_THREADS": str(THREADS) for library in LIBRARIES}
PRELOADED = "eitbench.benchmark.workers.preload"
_PR_SET_CHILD_SUBREAPER = 36  # of Linux: sys/prctl.h
# Cells run in threads, and starting a worker changes this process's environment for a moment.
_STARTING = threading.Lock()


def start_process(
    serve: Callable[..., None],
    arguments: tuple[object, ...],
    log: Path | None,
    core: int | None = None,
    confinement: Confinement | None = None,
) -> tuple[BaseProcess, Connection]:
    """Start `serve(connection, *arguments)` with its output going to `log` (None: nowhere).

    It and what it starts run on `core` alone, if there is one, within the `confinement`.
    """
    with _STARTING:
        context = process_context()
        environment = dict(os.environ)
    ours, theirs = context.Pipe()
    process: BaseProcess = context.Process(  # type: ignore[attr-defined]
        target=_enter,
        args=(theirs, log, core, confinement, environment, serve, arguments),
        name="eitbench-worker",
    )
    with _interrupts_blocked():
        process.start()
    theirs.close()
    return process, ours


def process_context() -> BaseContext:
    """Return the context that starts workers: from a server with eitbench loaded, else anew."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    # What this process needed its workers will: forked with it, they start a second earlier.
    needed = [name for name in ("torch",) if name in sys.modules]
    context.set_forkserver_preload([PRELOADED, *needed])
    resource_tracker.ensure_running()  # unblocks Ctrl-C when it starts, so not further down
    with _pinned_environment(), _interrupts_blocked():
        forkserver.ensure_running()
    return context


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Hide Ctrl-C from processes that start meanwhile; the parent sees it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _pinned_environment() -> Iterator[None]:
    """Set variables that libraries read once, when they are loaded in a new process."""
    before = {name: os.environ[name] for name in PINNED if name in os.environ}
    os.environ.update(PINNED)
    try:
        yield
    finally:
        for name in PINNED:
            del os.environ[name]
        os.environ.update(before)


def _enter(
    connection: Connection,
    log: Path | None,
    core: int | None,
    confinement: Confinement | None,
    environment: dict[str, str],
    serve: Callable[..., None],
    arguments: tuple[Any, ...],
) -> None:
    """Serve in a worker, with a process group and output of its own, on one thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    if hasattr(os, "setsid"):
        os.setsid()  # so that what the method starts dies with it
    if core is not None:
        os.sched_setaffinity(0, {core})
    _adopt_orphans()
    # The server of processes has the environment it was started in, which may be an older one.
    os.environ.clear()
    os.environ.update(environment | PINNED)
    with Path(log or os.devnull).open("a", buffering=1, errors="backslashreplace") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
        sys.stdout = sys.stderr = output
        faulthandler.enable(output)
        if confinement is not None:
            confinement.begin()
        # Begun last: a thread keeps the rights that it had when it was begun.
        threading.Thread(target=_die_with_parent, daemon=True).start()
        with threadpool_limits(THREADS), suppress(EOFError, ConnectionError):
            serve(connection, *arguments)
        # Nobody asks any more. Once this process is gone, nobody can tell what it started.
        end_tree(os.getpid())


def _adopt_orphans() -> None:
    """Keep every process that is started from here below this one, whatever it does."""
    if sys.platform == "linux":
        # Else a process whose parent ends belongs to the system's first one, where none finds it.
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _die_with_parent() -> None:
    """Wait for the end of the process that asked for this one, and end with it."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    parent.join()
    end_tree(os.getpid())
    os._exit(1)


def end_tree(pid: int) -> None:
    """Kill what the worker `pid` started, in its process group or out of it, then the group."""
    with suppress(psutil.Error):
        for process in psutil.Process(pid).children(recursive=True):
            with suppress(psutil.Error):
                process.kill()
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
