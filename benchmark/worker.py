"""A method in a process of its own, so that whatever it does costs its own rows only.

The parent sends `("fit",)` or `("reconstruct", frames)` and waits for a `Reply`, up to a time
limit; it never sends truth.
"""

import json
import random
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Literal

import numpy as np
import psutil
from numpy.typing import NDArray

from eitbench.benchmark.process import end_group, start_process
from eitbench.methods.method import Method
from eitbench.methods.problem import Problem, Splits
from eitbench.methods.registry import create, load_plugin
from eitbench.scenarios.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.scenario import Scenario
from eitbench.scenarios.sensors import Sensor

Frames = NDArray[np.float64]
Images = NDArray[np.float32]
Status = Literal["ok", "error", "timeout", "invalid-output", "out-of-memory"]

SEED = 0
POLL_SECONDS = 0.2
PLUGIN_LIMIT_S = 60.0
MAX_MESSAGE = 500


@dataclass(frozen=True, eq=False)
class Task:
    """What a worker is told: the problem without its test split, and the method to make.

    Attributes:
        plugin: the file that the method is registered in; no other is loaded, since loading one
            may change what is there already.
    """

    sensor: Sensor
    reference: Frames
    splits: Splits
    method: str
    parameters: Mapping[str, Any]
    plugin: Path | None = None


@dataclass(frozen=True)
class Failure:
    """Why a method gave no result.

    Attributes:
        message: a sentence for people.
        kinds: for programs: class names of the exception, or "mutated", "shape", "dtype".
    """

    status: Status
    message: str
    kinds: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Reply:
    """What a worker answers.

    Attributes:
        value: images (n, H, W) after "reconstruct", the method's parameters as JSON after "fit",
            a list of names after "names".
        seconds: time in the method alone.
        memory_mb: peak resident memory of the worker so far [MiB].
        failure: set where the method gave no result.
    """

    value: Any
    seconds: float
    memory_mb: float
    failure: Failure | None = None


class WorkerLostError(Exception):
    """The worker is gone: past its limit, dead, or stopped; nothing more can be asked of it."""

    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


class StoppedError(Exception):
    """The run was interrupted while a worker was busy."""


def learning_splits(scenario: Scenario, split: str, limit: int | None) -> Dataset:
    """Training or validation data of `scenario`; a method is never given the test split.

    Raises:
        InputError: any other split was asked for.
    """
    if split not in ("train", "validation"):
        raise InputError(f"A method may ask for the train or validation split, not for {split!r}.")
    return load(scenario, split=split, limit=limit)


def scenario_splits(scenario: Scenario) -> Splits:
    """`learning_splits` of one scenario, as a worker can be told it."""
    return partial(learning_splits, scenario)


class Worker:
    """The parent's end of one worker process; a context manager that always ends the process."""

    def __init__(
        self,
        serve: Callable[..., None],
        *arguments: object,
        log: Path | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        """Start `serve(connection, *arguments)` with its output going to `log` (None: nowhere)."""
        self._stop = stop or threading.Event()
        self._process, self._connection = start_process(serve, arguments, log)

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, *request: object, limit: float, what: str) -> Reply:
        """Send `request` and wait at most `limit` seconds for the answer.

        Raises:
            WorkerLostError: no answer in time, or the process died or answered nonsense; `what` it
                was doing is said.
            StoppedError: the run was interrupted.
        """
        deadline = time.monotonic() + limit
        try:
            self._connection.send(request)
            while not self._connection.poll():
                if self._stop.is_set():
                    self.close()
                    raise StoppedError
                left = deadline - time.monotonic()
                if left <= 0:
                    self.close()
                    raise WorkerLostError(
                        Failure("timeout", f"{what} took longer than {limit:g} s")
                    )
                ready = wait([self._connection, self._process.sentinel], min(left, POLL_SECONDS))
                if self._process.sentinel in ready and not self._connection.poll():
                    raise EOFError
            return self._receive(what)
        except (EOFError, OSError) as error:
            raise WorkerLostError(self._death(what)) from error

    def _receive(self, what: str) -> Reply:
        answer: object
        try:
            answer = self._connection.recv()
        except (EOFError, OSError):
            raise
        except Exception as error:  # what is on the pipe is no message of ours
            answer = error
        if isinstance(answer, Reply):
            return answer
        self.close()
        message = f"its process sent something that is no answer during {what}"
        raise WorkerLostError(Failure("error", message))

    def close(self) -> None:
        """End the process and every process it started."""
        self._connection.close()
        if self._process.is_alive():
            if self._process.pid is not None:
                end_group(self._process.pid)
            self._process.kill()
        self._process.join()

    def _death(self, what: str) -> Failure:
        self._process.join(5)
        code = self._process.exitcode
        if code is None:  # alive, but what it sent cannot be read
            self.close()
            return Failure("error", f"its process sent something that is no answer during {what}")
        if code < 0:
            if -code == getattr(signal, "SIGKILL", None):
                message = f"its process was killed (out of memory, or by hand) during {what}"
                return Failure("out-of-memory", message)
            name = signal.Signals(-code).name
            return Failure("error", f"its process died of {name} during {what}")
        return Failure("error", f"its process ended by itself (exit code {code}) during {what}")


def serve_method(connection: Connection, task: Task) -> None:
    """Answer "fit" and "reconstruct" for the method of `task` until the parent hangs up."""
    method: Method | None = None
    while True:
        operation, *arguments = connection.recv()
        seed_everything()
        start = time.perf_counter()
        value: object = None
        failure = None
        try:
            if operation == "fit":
                method, value, seconds = _fit(task)
            else:
                if method is None:
                    raise InputError("The method was not fitted.")
                value, seconds, failure = _reconstruct(
                    method, arguments[0], task.sensor.image_shape
                )
        except BaseException as error:  # a method may raise anything, SystemExit included
            seconds = time.perf_counter() - start
            failure = describe_exception(error)
        connection.send(Reply(value, seconds, peak_memory_mb(), failure))


def serve_plugin_names(connection: Connection, plugin: Path) -> None:
    """Answer once with the names of the methods in the file `plugin`."""
    connection.recv()
    names: list[str] = []
    failure = None
    start = time.perf_counter()
    try:
        names = load_plugin(plugin)
    except BaseException as error:  # whatever the file does stays in this process
        failure = describe_exception(error)
    connection.send(Reply(names, time.perf_counter() - start, peak_memory_mb(), failure))


def plugin_methods(path: Path) -> list[str]:
    """Names of the methods that the file `path` registers; it is loaded in a worker.

    Raises:
        InputError: the file does not load, or registers nothing.
    """
    with Worker(serve_plugin_names, path) as worker:
        try:
            reply = worker.ask("names", limit=PLUGIN_LIMIT_S, what=f"loading {path.name}")
        except WorkerLostError as lost:
            raise InputError(
                f"The plugin {path} cannot be loaded: {lost.failure.message}."
            ) from lost
    if reply.failure is not None:
        raise InputError(reply.failure.message.removeprefix("InputError: "))
    return list(reply.value)


def _fit(task: Task) -> tuple[Method, str, float]:
    if task.plugin is not None:
        load_plugin(task.plugin)
    method = create(task.method, **task.parameters)
    parameters = json.dumps(constructor_parameters(method) | dict(task.parameters), default=str)
    problem = Problem(task.sensor, task.reference, task.splits)
    start = time.perf_counter()
    method.fit(problem)
    return method, parameters, time.perf_counter() - start


def _reconstruct(
    method: Method, frames: Frames, image_shape: tuple[int, int]
) -> tuple[Images | None, float, Failure | None]:
    given = frames.copy()
    start = time.perf_counter()
    answer = method.reconstruct(given)
    try:
        # The conversion is timed too: it waits for a device that computes asynchronously.
        result = np.asarray(answer)
    except (TypeError, ValueError):
        message = f"returned a {type(answer).__name__} that is not an array"
        seconds = time.perf_counter() - start
        return None, seconds, Failure("invalid-output", message, ("shape",))
    seconds = time.perf_counter() - start
    if not np.array_equal(given, frames, equal_nan=True):
        message = "changed its input voltages in place"
        return None, seconds, Failure("error", message, ("mutated",))
    expected = (len(frames), *image_shape)
    if result.shape != expected:
        message = f"returned an array of shape {result.shape} instead of {expected}"
        return None, seconds, Failure("invalid-output", message, ("shape",))
    if result.dtype.kind not in "fiu":
        message = f"returned values of type {result.dtype} instead of real numbers"
        return None, seconds, Failure("invalid-output", message, ("dtype",))
    with np.errstate(over="ignore"):  # what does not fit becomes inf and is reported as such
        return result.astype(np.float32), seconds, None


def describe_exception(error: BaseException) -> Failure:
    """The typed failure of an exception that a method raised, its message fit for any file."""
    status: Status = "out-of-memory" if isinstance(error, MemoryError) else "error"
    kinds = tuple(kind.__name__ for kind in type(error).__mro__)
    try:
        said = str(error)
    except Exception:  # its own __str__ may be wrong too
        said = "(its message cannot be printed)"
    message = f"{kinds[0]}: {said}".encode(errors="backslashreplace").decode()
    if len(message) > MAX_MESSAGE:
        message = message[: MAX_MESSAGE - 1] + "…"
    return Failure(status, message, kinds)


def constructor_parameters(method: Method) -> dict[str, Any]:
    """Every constructor parameter of a method that is a dataclass, defaults included."""
    declared: dict[str, Field[Any]] = getattr(method, "__dataclass_fields__", {})
    return {name: getattr(method, name) for name, field in declared.items() if field.init}


def seed_everything() -> None:
    """Seed the global generators before every request, so that resuming changes nothing."""
    random.seed(SEED)
    np.random.seed(SEED)  # noqa: NPY002  (plugins may draw from the global generator)


def peak_memory_mb() -> float:
    """Peak resident memory of this process [MiB]."""
    peak_on_windows = getattr(psutil.Process().memory_info(), "peak_wset", None)
    if peak_on_windows is not None:
        return float(peak_on_windows) / 2**20
    import resource  # not on Windows

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
