"""Files that somebody else wrote, tried first in a process that may die of them.

A parser may hang, crash or take all memory with a file that was made for it. The process that tries
it first has limits of time and memory; nothing but a sentence comes back from it.
"""

import faulthandler
import json
import os
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil

from eitbench.scenarios.errors import DataCorruptError, EitbenchError, InputError, UnreadableError
from eitbench.scenarios.storage.limits import check_regular

TIME_LIMIT_S, MEMORY_LIMIT_MB = 120, 4096

MAX_MESSAGE = 2000  # characters
_ERRORS = {
    kind.__name__: kind for kind in (EitbenchError, InputError, UnreadableError, DataCorruptError)
}


def try_reading(path: Path, read: Callable[..., object], *arguments: object) -> None:
    """Call `read(*arguments)`, which reads `path`, in a process of its own that is then gone.

    Where processes cannot be forked safely (macOS, Windows) nothing is tried.

    Raises:
        DataCorruptError: it took longer than `TIME_LIMIT_S`, needed more than `MEMORY_LIMIT_MB`, or
            ended the process.
        UnreadableError: it is no file that could be read to its end.
        EitbenchError: as `read` raises.
    """
    try:
        check_regular(path)
    except FileNotFoundError:
        pass  # what reads it says so
    except OSError as error:
        raise UnreadableError(f"Cannot read {path}: {error.strerror}.") from error
    if sys.platform != "linux":
        return
    answers, ours = os.pipe()
    with warnings.catch_warnings():
        # Threads of this process are not in the new one, which asks nothing of them.
        warnings.simplefilter("ignore")
        child = os.fork()
    if child == 0:
        _answer(ours, path, read, arguments)
    os.close(ours)
    try:
        with os.fdopen(answers, "rb") as file:
            said = file.read()
    except BaseException:  # Ctrl-C
        os.kill(child, signal.SIGKILL)
        raise
    finally:
        _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        ended_by = os.WTERMSIG(status)
        why = (
            f"that takes longer than {TIME_LIMIT_S} s"
            if ended_by == signal.SIGALRM
            else f"what reads it died of {signal.Signals(ended_by).name}"
        )
        raise DataCorruptError(f"{path} cannot be read: {why}.")
    if said:
        kind, message = json.loads(said)
        raise _ERRORS[kind](message)


def _answer(
    pipe: int, path: Path, read: Callable[..., object], arguments: tuple[object, ...]
) -> None:
    """In the new process: read, write the error as JSON to `pipe` if there is one, and end."""
    import resource  # not on Windows

    found: EitbenchError | None = None
    try:
        for number in (signal.SIGALRM, signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
        signal.alarm(TIME_LIMIT_S)
        faulthandler.disable()
        # What a library says as it dies would stand between the lines of this program.
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        most = psutil.Process().memory_info().vms + MEMORY_LIMIT_MB * 2**20
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
        read(*arguments)
    except MemoryError:
        found = DataCorruptError(
            f"{path} cannot be read: that takes more than {MEMORY_LIMIT_MB} MB of memory."
        )
    except EitbenchError as error:
        found = error
    except BaseException:  # a mistake of ours shows itself, with its place, where it is read next
        found = None
    with suppress(BaseException):
        if found is not None:
            kind = next(of.__name__ for of in type(found).__mro__ if of.__name__ in _ERRORS)
            os.write(pipe, json.dumps([kind, str(found)[:MAX_MESSAGE]]).encode())
    os._exit(0)
