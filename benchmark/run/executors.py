"""Executors: cells run on this machine or on those of a Dask cluster, by the same code.

On a cluster a cell is run in tasks of some minutes. A task gets the stored batches of its cell,
continues as a resumed run does, and sends the stored batches back: after each task the rows are
here, and safe. The scheduler gives a task whose machine is lost to another one.
"""

import itertools
import logging
import multiprocessing
import re
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eitbench.benchmark.run.cell import prepare, run_cell
from eitbench.benchmark.run.cell_task import CellData, CellPlan
from eitbench.benchmark.run.progress import Advance
from eitbench.benchmark.run.timing import core_to_pin
from eitbench.benchmark.rundir import manifest
from eitbench.benchmark.rundir.cells import Cell
from eitbench.benchmark.rundir.kinds import RUN_KINDS
from eitbench.benchmark.rundir.run_arrays import TRUTH
from eitbench.benchmark.rundir.store import Files, RunStore
from eitbench.benchmark.workers.confinement import check_isolation
from eitbench.benchmark.workers.process import check_guarded, process_context
from eitbench.benchmark.workers.worker import StoppedError
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.extras import missing

if TYPE_CHECKING:
    from distributed import Client, Future

REMOTE_TASK_SECONDS = 600.0
CONNECT_SECONDS = 10.0
POLL_SECONDS = 0.5
ATTEMPTS = 3
# Cells that a cluster runs at a time: for each a thread waits here.
REMOTE_SLOTS = 256


@dataclass(frozen=True)
class Executor:
    """Runs cells on this machine, each in the thread that calls it.

    Attributes:
        slots: number of cells that may run at a time.
        isolate: true if methods may neither use the network nor read files of others.
        calm_ms: see `Conditions`; of the runs with one slot.
    """

    slots: int
    isolate: bool = False
    calm_ms: float | None = None

    def run(
        self,
        data: CellData,
        plan: CellPlan,
        store: RunStore,
        progress: Advance,
        stop: threading.Event,
    ) -> None:
        """Run the batches that are not stored yet.

        Raises:
            StoppedError: stopped; finished batches are stored.
            EitbenchError: the store cannot be written or read, or what others wait for fails.
        """
        task = data.task(plan, store)
        if plan.cell.name == TRUTH:
            prepare(task, progress, stop)
        else:
            core = core_to_pin() if self.slots == 1 else None
            calm_ms = None if core is None else self.calm_ms
            run_cell(task, progress, stop, core, calm_ms=calm_ms, isolate=self.isolate)


@dataclass(frozen=True, eq=False)
class RemoteTask:
    """A request to a machine of the cluster, apart from the data.

    Attributes:
        stored: stored batches of the cell, and of the one that it is compared with.
        plugin: content of the file that registers it, if there is one.
        weights: SHA-256 of the weights that it loads here.
        versions: of this machine's packages, which results rest on.
        seconds: after so long the task is stopped.
    """

    plan: CellPlan
    stored: Mapping[Cell, Files]
    plugin: bytes | None
    weights: str
    versions: Mapping[str, str | None]
    seconds: float


@dataclass(frozen=True, eq=False)
class RemoteResult:
    """Result of a remote task.

    Attributes:
        stored: stored batches of the cell.
        log: output of the method or operator.
        finished: true if nothing is left to do.
    """

    stored: Files
    log: bytes
    finished: bool


class DaskExecutor(Executor):
    """Runs cells on the machines of the Dask scheduler that `client` is connected to."""

    def __init__(self, client: "Client") -> None:
        super().__init__(REMOTE_SLOTS)
        self._client = client
        self._lock = threading.Lock()
        self._scattered: dict[str, Future] = {}

    def run(
        self,
        data: CellData,
        plan: CellPlan,
        store: RunStore,
        progress: Advance,
        stop: threading.Event,
    ) -> None:
        """See `Executor.run`."""
        cell, done, finished = plan.cell, 0, False
        needed = [cell] if (model := data.preparation(plan)) is None else [cell, model.cell]
        while not finished:
            task = RemoteTask(
                plan,
                {there: store.pack(there) for there in needed},
                None if plan.plugin is None else plan.plugin.read_bytes(),
                data.weights(cell.name),
                manifest.versions(),
                REMOTE_TASK_SECONDS,
            )
            answer = self._answer(data, task, stop)
            with store.log(cell).open("ab") as log:
                log.write(answer.log)
            store.unpack(cell, answer.stored)
            parts = (store.batches(cell, split) for split in ("validation", "test"))
            stored = sum(len(batch) for part in parts for batch in part)
            progress(max(0, stored - done))
            done, finished = stored, answer.finished

    def _answer(self, data: CellData, task: RemoteTask, stop: threading.Event) -> RemoteResult:
        """Return the answer of the cluster to a task."""
        from distributed import CancelledError, KilledWorker

        name = str(task.plan.cell)
        for _ in range(ATTEMPTS):
            try:
                self._await_machines(stop)
                return self._result(data, task, stop)
            except KilledWorker as error:
                raise EitbenchError(
                    f"Every machine that worked on {name} was lost: see in their logs why, and "
                    "whether they have enough memory."
                ) from error
            except CancelledError:  # the data went with the last machine that had them
                with self._lock:
                    self._scattered.pop(data.scenario.name, None)
            except StoppedError:
                raise
            except Exception as error:
                # Without its scheduler the client raises whatever comes, AttributeError included.
                if self._client.status == "running" and not isinstance(error, OSError):
                    raise
                raise EitbenchError("The Dask scheduler no longer answers.") from error
        raise EitbenchError(f"The cluster lost the data of {name} {ATTEMPTS} times.")

    def _result(self, data: CellData, task: RemoteTask, stop: threading.Event) -> RemoteResult:
        future = self._client.submit(_run_remote_task, self._data(data), task, pure=False)
        ended = threading.Event()
        future.add_done_callback(lambda _: ended.set())
        while not ended.wait(POLL_SECONDS):
            if stop.is_set():
                future.cancel()
                raise StoppedError
        answer: RemoteResult = future.result()
        return answer

    def _await_machines(self, stop: threading.Event) -> None:
        """Wait for the first machine: they may stand in a queue for hours."""
        while not self._client.scheduler_info(n_workers=1)["workers"]:
            if stop.wait(POLL_SECONDS):
                raise StoppedError

    def _data(self, data: CellData) -> "Future":
        """Return the data of a scenario on the cluster; they are sent to each machine once."""
        with self._lock:
            name = data.scenario.name
            if name not in self._scattered:
                (self._scattered[name],) = self._client.scatter([data], broadcast=True, hash=False)
            return self._scattered[name]


@contextmanager
def executor(
    jobs: int, scheduler: str | None, isolate: bool, calm_ms: float | None
) -> Iterator[Executor]:
    """Yield the executor: this machine with `jobs` cells at a time, or a cluster.

    Args:
        scheduler: address of the Dask scheduler of the cluster; None for this machine.
        isolate, calm_ms: see `Executor`; for this machine only.

    Raises:
        InputError: `distributed` is not installed, no scheduler answers there, or methods cannot
            be isolated.
    """
    check_guarded()  # before data are simulated
    if isolate:
        check_isolation()
        if scheduler is not None:
            raise InputError("--isolate is for this machine: leave out --scheduler.")
    if scheduler is None:
        process_context()  # what workers are forked from loads eitbench while data are loaded
        yield Executor(jobs, isolate, calm_ms)
        return
    if not re.search(r":\d+$", scheduler):
        raise InputError(
            f"A Dask scheduler has an address such as tcp://10.0.0.1:8786, got {scheduler!r}."
        )
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(missing("distributed")) from error
    # What goes wrong is said in our own sentences.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"No Dask scheduler answers at {scheduler!r}: start one with `dask scheduler`, and "
            "give the address that it prints."
        ) from error
    with client:
        yield DaskExecutor(client)


def _run_remote_task(data: CellData, task: RemoteTask) -> RemoteResult:
    """Run a task on this machine of a cluster, if it has what the one that asks has."""
    if changed := manifest.changed_versions(task.versions):
        raise EitbenchError(
            f"A machine of the cluster has another version of {', '.join(changed)} than this one: "
            "install the same on all."
        )
    name = task.plan.cell.name
    if data.weights(name) != task.weights:
        raise EitbenchError(
            f"A machine of the cluster has other weights of {name!r} than this one: copy them "
            "into its cache (EITBENCH_CACHE)."
        )
    # Dask starts its processes as daemons, which Python would not let start others.
    multiprocessing.current_process().daemon = False
    try:
        return _run_here(data, task)
    except OSError as error:  # of its disk: one of the client's says that the scheduler is gone
        raise EitbenchError(f"A machine of the cluster cannot go on: {error}.") from error


def _run_here(data: CellData, task: RemoteTask) -> RemoteResult:
    with tempfile.TemporaryDirectory(prefix="eitbench-") as folder:
        plan, cell = task.plan, task.plan.cell
        store = RunStore.create(Path(folder) / "run", RUN_KINDS[plan.suite.ranks])
        if plan.plugin is not None and task.plugin is not None:
            copy = Path(folder) / plan.plugin.name
            copy.write_bytes(task.plugin)
            plan = replace(plan, plugin=copy)
        for there, files in task.stored.items():
            store.unpack(there, files)
        with _cancellation() as stop:
            try:
                # A cluster may give one machine several tasks: none has a core of its own.
                Executor(REMOTE_SLOTS).run(data, plan, store, _deadline(task.seconds), stop)
                finished = True
            except StoppedError:
                finished = False
        log = store.log(cell)
        return RemoteResult(store.pack(cell), log.read_bytes() if log.exists() else b"", finished)


def _deadline(seconds: float) -> Advance:
    """Return a progress bar that stops its job `seconds` after its first batch.

    What goes before that is repeated when the job is taken up again: it is not to be all there is.
    """
    deadline, calls = float("inf"), itertools.count()

    def advance(_: int) -> None:
        nonlocal deadline
        now = time.monotonic()
        if next(calls) == 1:  # the first call counts what was stored before
            deadline = now + seconds
        if now >= deadline:
            raise StoppedError

    return advance


@contextmanager
def _cancellation() -> Iterator[threading.Event]:
    """Yield an event that is set when the task that runs in this thread was cancelled."""
    from distributed import get_worker

    worker, stop, over = get_worker(), threading.Event(), threading.Event()
    key: Any = worker.get_current_task()

    def watch() -> None:
        while not over.wait(POLL_SECONDS):
            task = worker.state.tasks.get(key)
            if task is None or task.state in ("cancelled", "released"):
                stop.set()
                return

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield stop
    finally:
        over.set()
