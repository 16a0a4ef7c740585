"""One process at a time in a run directory."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.storage.files import writing

FILE_NAME = ".lock"


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Hold the run directory `run`, by a lock of the system's that ends with the process.

    It holds between machines, too, where their shared disk knows locks. A killed process leaves the
    file behind, but not the lock.

    Raises:
        InputError: another process holds it.
        EitbenchError: the folder cannot be written.
    """
    path = run / FILE_NAME
    lock = FileLock(path, timeout=0)
    with writing(path):
        try:
            lock.acquire()
        except Timeout as error:
            raise InputError(
                f"Another process is working on {run}: wait until it has ended, or end it."
            ) from error
    try:
        yield
    finally:
        try:
            # Before it is let go: nobody gets a lock on a file that is not there any more.
            path.unlink(missing_ok=True)
            lock.release()
        except PermissionError:
            # Windows removes no file that is open: afterwards, unless another process holds it.
            lock.release()
            with suppress(PermissionError):
                path.unlink(missing_ok=True)
