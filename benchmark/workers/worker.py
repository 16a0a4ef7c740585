"""A process of its own for code that is scored, so that whatever it does costs its own rows only.

The parent sends the name of one of the service's methods with its arguments, and waits for a
`Reply`, up to a time limit; it never sends truth.
"""

import os
import random
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import psutil
from numpy.typing import NDArray
from pydantic import TypeAdapter

from eitbench.benchmark.workers.confinement import Confinement
from eitbench.benchmark.workers.messages import (
    Failure,
    Reply,
    Status,
    WorkerLostError,
    decode,
    encode,
    no_answer,
    parsed,
    plain_text,
    plain_trace,
)
from eitbench.benchmark.workers.process import start_process
from eitbench.methods.places.by_image import create_place_method
from eitbench.methods.registry import (
    METHOD_REGISTRY,
    OPERATOR_REGISTRY,
    PLACE_REGISTRY,
    Registry,
    load_plugin,
    usable_name,
)
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.guard import close_test_split
from eitbench.scenarios.suites.suite import MEMORY_LIMIT_MB

SEED = 0
POLL_SECONDS = 0.2
PLUGIN_LIMIT_S = 60.0
LOG_LIMIT, LOG_HEAD = 2**24, 2**20  # bytes: a log that is longer than the first keeps the second


class StoppedError(Exception):
    """The run was interrupted while a worker was busy."""


class Worker:
    """The parent's end of one worker process; a context manager that always ends the process."""

    def __init__(
        self,
        serve: Callable[..., None],
        *arguments: object,
        log: Path | None = None,
        stop: threading.Event | None = None,
        memory_limit_mb: float = MEMORY_LIMIT_MB,
        core: int | None = None,
        confinement: Confinement | None = None,
    ) -> None:
        """Start `serve(connection, *arguments)` with its output going to `log` (None: nowhere).

        Args:
            memory_limit_mb: resident memory that it and the processes it starts may take [MiB].
            core: the only core that it runs on; None: any.
            confinement: what it may write to and read; None: all that its user may.
        """
        self._log = log
        self._stop = stop or threading.Event()
        self._memory_limit_mb = memory_limit_mb
        self._late = threading.Event()
        self._process, self._connection = start_process(serve, arguments, log, core, confinement)

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, *request: object, limit: float, what: str) -> Reply:
        """Send `request` and wait at most `limit` seconds for the answer.

        Raises:
            WorkerLostError: no answer in time, too much memory, or the process died or answered
                nonsense; `what` it was doing is said.
            StoppedError: the run was interrupted.
        """
        # Also against half a message, which would be waited for without end.
        ending = threading.Timer(limit, self._end_late)
        ending.daemon = True
        ending.start()
        try:
            with suppress(ConnectionError):  # it has ended; what it sent before is read below
                self._connection.send(request)
            # However fast it answers, a stop is noticed with the next request.
            while self._stop.is_set() or not self._connection.poll():
                if self._stop.is_set():
                    self.close()
                    raise StoppedError
                ready = wait([self._connection, self._process.sentinel], POLL_SECONDS)
                if self._process.sentinel in ready and not self._connection.poll():
                    raise EOFError
                if not ready:
                    self._shorten_log()
                    self._hold_to_memory(self._process.memory_mb(), what)
            reply = decode(self._connection.recv_bytes)
        except ValueError as error:
            self.close()
            raise no_answer(what) from error
        except (EOFError, OSError) as error:
            if self._late.is_set():
                ending.join()
                self.close()
                message = f"{what} took longer than {limit:g} s"
                raise WorkerLostError(Failure("timeout", message)) from error
            ending.cancel()  # or its end would be taken for the worker's own
            raise self._death(what) from error
        finally:
            ending.cancel()
        ending.join()
        if self._late.is_set():  # the answer came as the process was ended: it is late, too
            self.close()
            raise WorkerLostError(Failure("timeout", f"{what} took longer than {limit:g} s"))
        self._shorten_log()
        self._hold_to_memory(reply.memory_mb, what)
        return reply

    def _end_late(self) -> None:
        self._late.set()
        self._process.end()

    def _hold_to_memory(self, used_mb: float, what: str) -> None:
        if used_mb > self._memory_limit_mb:
            self.close()
            message = f"{what} took more than {self._memory_limit_mb:g} MB of memory"
            raise WorkerLostError(Failure("out-of-memory", message))

    def _shorten_log(self) -> None:
        """Keep the head of a log that has grown too long; what is written next is appended."""
        with suppress(OSError):  # it is not there yet, or its disk has gone
            if self._log is not None and self._log.stat().st_size > LOG_LIMIT:
                os.truncate(self._log, LOG_HEAD)

    def close(self) -> None:
        """End the process and every process it started."""
        self._connection.close()
        self._process.end()

    def _death(self, what: str) -> WorkerLostError:
        code = self._process.exit_code()
        if code is None:  # alive, but what it sent cannot be read
            self.close()
            return no_answer(what)
        status: Status = "error"
        if code >= 0:
            how = f"ended by itself (exit code {code})"
        elif -code == getattr(signal, "SIGKILL", None):
            status, how = "out-of-memory", "was killed (out of memory, or by hand)"
        else:
            named = {known.value: known.name for known in signal.Signals}
            how = f"died of {named.get(-code, f'signal {-code}')}"
        return WorkerLostError(Failure(status, f"its process {how} during {what}"))


def serve(connection: Connection, service: object) -> None:
    """Answer requests, each a method of `service` that gives a `Reply`, until there are no more."""
    own = os.getpid()
    while True:
        operation, *arguments = connection.recv()
        seed_everything()
        start = time.perf_counter()
        try:
            reply: Reply = getattr(service, operation)(*arguments)
            message = encode(replace(reply, memory_mb=peak_memory_mb()))
        except BaseException as error:  # scored code may raise anything, SystemExit included
            failure, seconds = describe_exception(error), time.perf_counter() - start
            message = encode(Reply(None, seconds, failure, peak_memory_mb()))
        if os.getpid() != own:  # scored code has forked, and its child came back, too
            os._exit(0)
        for piece in message:
            connection.send_bytes(piece)


class _PluginReader:
    """Reads the names that the file `plugin` registers, and makes methods with parameters."""

    def __init__(
        self, plugin: Path, parameters: Mapping[str, Mapping[str, Any]] = MappingProxyType({})
    ) -> None:
        self._plugin = plugin
        self._parameters = dict(parameters)  # which can be sent to the worker

    def names(self) -> Reply:
        close_test_split()
        loaded = load_plugin(self._plugin)
        for name in {*loaded.methods, *loaded.places} & self._parameters.keys():
            create_place_method(name, **self._parameters[name])
        found = PluginNames(
            {name: _source_lines(METHOD_REGISTRY, name) for name in loaded.methods},
            {name: _source_lines(PLACE_REGISTRY, name) for name in loaded.places},
            {name: _source_lines(OPERATOR_REGISTRY, name) for name in loaded.operators},
        )
        return Reply(found._asdict(), 0.0)


def _source_lines(registry: Registry[Any], name: str) -> list[str]:
    return str(registry.known()[name].source).splitlines()  # a message shortens each text


class PluginNames(NamedTuple):
    """The names that a file registers, and the lines of the `source` of each."""

    methods: dict[str, list[str]]
    places: dict[str, list[str]]
    operators: dict[str, list[str]]


_NAMES = TypeAdapter(PluginNames)


def plugin_names(
    path: Path,
    *,
    parameters: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    isolate: bool = False,
) -> PluginNames:
    """Return the names of the methods and operators that the file `path` registers.

    A worker loads the file, confined like those of a run; with `isolate` it may neither use the
    network nor read other files.

    Args:
        parameters: constructor parameters by method, which those of the file have to take.

    Raises:
        InputError: the file does not load, registers nothing, or a method takes other parameters.
    """
    with (
        TemporaryDirectory(prefix="eitbench-", ignore_cleanup_errors=True) as folder,
        Worker(
            serve,
            _PluginReader(path, parameters),
            confinement=Confinement(Path(folder), (path,) if isolate else None),
        ) as worker,
    ):
        try:
            what = f"loading {path.name}"
            reply = worker.ask("names", limit=PLUGIN_LIMIT_S, what=what)
            if reply.failure is None:
                names: PluginNames = parsed(_NAMES, reply.value, what)
                if all(map(usable_name, (*names.methods, *names.places, *names.operators))):
                    return names
                raise no_answer(what)  # the registry of its process lets none other pass
        except WorkerLostError as lost:
            raise InputError(
                f"The plugin {path} cannot be loaded: {lost.failure.message}."
            ) from lost
    refused = InputError(reply.failure.message.removeprefix("InputError: "))
    refused.add_note(reply.failure.trace)
    raise refused


def timed_answer(
    function: Callable[..., object], inputs: Sequence[NDArray[Any]], *shapes: tuple[int, ...]
) -> Reply:
    """Ask scored code for real numbers of one of these `shapes`; the reply holds the array.

    It is given copies of the `inputs`, and may not change them.
    """
    given = [array.copy() for array in inputs]
    start = time.perf_counter()
    answer: Any = function(*given)
    array: NDArray[Any] | None = None
    with suppress(TypeError, ValueError):
        # A part of its time: it waits for a device. What is masked is no value.
        masked = isinstance(answer, np.ma.MaskedArray)
        array = answer.astype(float).filled(np.nan) if masked else np.asarray(answer)
    seconds = time.perf_counter() - start
    failure = None
    if array is None:
        message = f"returned a {type(answer).__name__} that is not an array"
        failure = Failure("invalid-output", message, ("shape",))
    elif array.shape not in shapes:
        expected = " or ".join(map(str, shapes))
        message = f"returned an array of shape {array.shape} instead of {expected}"
        failure = Failure("invalid-output", message, ("shape",))
    elif array.dtype.kind not in "fiu":
        message = f"returned values of type {array.dtype} instead of real numbers"
        failure = Failure("invalid-output", message, ("dtype",))
    elif any(not np.array_equal(*pair, equal_nan=True) for pair in zip(given, inputs, strict=True)):
        failure = Failure("error", "changed its input in place", ("mutated",))
    return Reply(None if failure else array, seconds, failure)


def describe_exception(error: BaseException) -> Failure:
    """Return the failure of an exception that scored code raised, its message fit for any file."""
    status: Status = "out-of-memory" if isinstance(error, MemoryError) else "error"
    kinds = tuple(kind.__name__ for kind in type(error).__mro__)
    try:
        said = str(error)
    except Exception:  # its own __str__ may be wrong too
        said = "(its message cannot be printed)"
    return Failure(status, plain_text(f"{kinds[0]}: {said}"), kinds, plain_trace(trace_of(error)))


# Modules that call scored code: their frames say nothing about it.
_CALLERS = ("eitbench.benchmark.", "eitbench.methods.registry", "importlib.", "_frozen_importlib")


def trace_of(error: BaseException) -> str:
    """Return the frames of scored code that led to `error`, the first cause first.

    Files are named from the folder that they are imported from. Our own refusals need no frames.
    """
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__ or (None if cause.__suppress_context__ else cause.__context__)
    parts = []
    for each in reversed(chain):
        walked = traceback.walk_tb(each.__traceback__)
        names = [str(frame.f_globals.get("__name__")) for frame, _ in walked]
        called = next((k for k, name in enumerate(names) if not name.startswith(_CALLERS)), None)
        ours = all(name.startswith("eitbench.") for name in names[called:])
        if called is None or (ours and isinstance(each, EitbenchError)):
            continue
        frames = traceback.extract_tb(each.__traceback__)[called:]
        for frame in frames:
            frame.filename = _short(frame.filename)
        parts.append("".join(traceback.format_list(frames)).rstrip())
    return "\nwhich led to:\n".join(parts)


def _short(file: str) -> str:
    """Return the path of a module's file from the folder it is imported from."""
    folders = sorted((f"{place}{os.sep}" for place in sys.path if place), key=len, reverse=True)
    folder = next((place for place in folders if file.startswith(place)), "")
    return file.removeprefix(folder) if folder else Path(file).name


def seed_everything() -> None:
    """Seed the global generators before every request, so that resuming changes nothing."""
    random.seed(SEED)
    np.random.seed(SEED)  # noqa: NPY002  (plugins may draw from the global generator)


def peak_memory_mb() -> float:
    """Return the peak resident memory of this process [MiB]."""
    peak_on_windows = getattr(psutil.Process().memory_info(), "peak_wset", None)
    if peak_on_windows is not None:
        return float(peak_on_windows) / 2**20
    import resource  # not on Windows

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
