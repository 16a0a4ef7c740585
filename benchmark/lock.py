"""One process at a time in a run directory."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from eitbench.scenarios.errors import EitbenchError, InputError

FILE_NAME = ".lock"
TAKING_OVER = ".lock-taking-over"


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Hold the run directory `run`; the lock of a process that no longer lives is taken over.

    Raises:
        InputError: another process holds it.
        EitbenchError: the folder cannot be written.
    """
    path = run / FILE_NAME
    try:
        if not _create(path):
            _take_over(run)
    except OSError as error:
        raise EitbenchError(f"Could not write {path}: {error.strerror or error}.") from error
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _take_over(run: Path) -> None:
    path, guard = run / FILE_NAME, run / TAKING_OVER
    # Without a guard two that find a dead process's lock could each remove the other's new one.
    if not _holder_lives(path) and _create(guard):
        try:
            if not _holder_lives(path):
                path.unlink(missing_ok=True)
                if _create(path):
                    return
        finally:
            guard.unlink(missing_ok=True)
    names = f"{path} and {guard}" if guard.exists() else str(path)
    raise InputError(
        f"Another process is working on {run}: wait until it has ended, or delete {names} if there "
        "is none."
    )


def _create(path: Path) -> bool:
    """Write this process's identity to the new file `path`; False if the file exists."""
    try:
        descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
    except FileExistsError:
        return False
    with os.fdopen(descriptor, "w") as file:
        json.dump({"pid": os.getpid(), "started": psutil.Process().create_time()}, file)
    return True


def _holder_lives(path: Path) -> bool:
    """Whether the process that wrote `path` lives; a file that cannot be read counts as one."""
    try:
        holder = json.loads(path.read_text())
        # A number may belong to another process by now: its start tells them apart.
        started = psutil.Process(holder["pid"]).create_time()
        return bool(abs(started - holder["started"]) < 1.0)
    except (FileNotFoundError, psutil.NoSuchProcess):
        return False
    except (ValueError, KeyError, TypeError, RecursionError, psutil.AccessDenied):
        return True
