"""Worker processes: started from one server, on one thread, undisturbed by the terminal.

The server is forked for the guard of a worker, and the guard for the worker. A server that is lost
is started again, and costs no worker that runs.
"""

import ctypes
import faulthandler
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from multiprocessing.util import get_temp_dir
from pathlib import Path
from typing import Any

import psutil
from threadpoolctl import threadpool_limits

from eitbench.benchmark.workers.audit_hook import TEMPORARY
from eitbench.benchmark.workers.confinement import Confinement
from eitbench.benchmark.workers.control_group import enter_group, make_group
from eitbench.benchmark.workers.memory import SHARED_MEMORY, MemoryMeter
from eitbench.scenarios.errors import EitbenchError, InputError

THREADS = 1
LIBRARIES = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMBA")
PINNED = {f"{library}_NUM_THREADS": str(THREADS) for library in LIBRARIES}
SOCKETS = "EITBENCH_SOCKETS"  # names the folder of the server's socket to the server
PRELOADED = "eitbench.benchmark.workers.preload"
JOIN_SECONDS = 5.0
READY_SECONDS = 300.0  # the server may have loops to compile first
READY = b"ready"
PAUSES = (0.0, 0.1, 1.0, 5.0)  # seconds before each attempt to start a worker
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # of Linux: sys/prctl.h
# Cells run in threads. Starting a worker changes this process's environment for a moment, and ends
# the server where it fails.
_STARTING = threading.Lock()


class WorkerProcess:
    """The run's end of a worker process and of its guard, which outlives it.

    Attributes:
        pid: process id of the guard; the worker, and all that it starts, are below it.
        sentinel: can be read from once the worker has ended, see `multiprocessing.connection.wait`.
    """

    def __init__(self, process: BaseProcess, sentinel: Connection) -> None:
        self._process, self.sentinel = process, sentinel
        assert process.pid is not None  # it was started
        self.pid = process.pid
        self._memory = MemoryMeter(process.pid)

    def exit_code(self) -> int | None:
        """Return the exit code of the worker, or None if it has not ended within some seconds."""
        try:
            return int(self.sentinel.recv_bytes()) if self.sentinel.poll(JOIN_SECONDS) else None
        except (EOFError, OSError):  # its guard was killed, and so was the worker
            self._process.join(JOIN_SECONDS)
            return self._process.exitcode

    def memory_mb(self) -> float:
        """Return the memory that the worker takes, with all that it started [MiB]."""
        return self._memory.used_mb()

    def end(self) -> None:
        """End the worker and every process that it started."""
        with suppress(EOFError, OSError):
            self.sentinel.send_bytes(b"end")
            while self.sentinel.poll(JOIN_SECONDS):
                self.sentinel.recv_bytes()
            # Not for ever: a guard can be stopped, and so can a disk that a process waits for.
            end_tree(self.pid)
            self._process.kill()
        self._process.join(JOIN_SECONDS)


def start_process(
    serve: Callable[..., None],
    arguments: tuple[object, ...],
    log: Path | None,
    core: int | None = None,
    confinement: Confinement | None = None,
) -> tuple[WorkerProcess, Connection]:
    """Start `serve(connection, *arguments)` with its output going to `log` (None: nowhere).

    It and what it starts run on `core` alone, if there is one, within the `confinement`.

    Raises:
        EitbenchError: it cannot be started. No scored code has run, and none is to blame.
    """
    reason: Exception | None = None
    for pause in PAUSES:
        time.sleep(pause)
        with _STARTING:
            try:
                return _start(serve, arguments, log, core, confinement)
            except (OSError, EOFError) as error:
                reason = error
                _end_server()
    raise EitbenchError(
        f"No worker process can be started ({str(reason) or 'it ends at once'}). No method is to "
        "blame: look for a lack of memory, processes or space for temporary files."
    ) from reason


def _start(
    serve: Callable[..., None],
    arguments: tuple[object, ...],
    log: Path | None,
    core: int | None,
    confinement: Confinement | None,
) -> tuple[WorkerProcess, Connection]:
    context = process_context()
    environment = dict(os.environ)
    cores = None
    if hasattr(os, "sched_getaffinity"):
        cores = os.sched_getaffinity(0) if core is None else {core}
    ours, theirs = context.Pipe()
    sentinel, run = context.Pipe()
    process: BaseProcess = context.Process(  # type: ignore[attr-defined]
        target=_enter,
        args=(theirs, run, log, cores, confinement, environment, serve, arguments),
        name="eitbench-worker",
    )
    with _interrupts_blocked():
        process.start()
    theirs.close()
    run.close()
    worker = WorkerProcess(process, sentinel)
    if not sentinel.poll(READY_SECONDS):
        worker.end()
        raise TimeoutError(f"it is not ready after {READY_SECONDS:g} s")
    if sentinel.recv_bytes() != READY:  # but its exit code
        raise EOFError
    return worker, ours


def check_guarded() -> None:
    """Check that a script that starts workers can be imported by them without starting its own.

    Raises:
        InputError: it has no `if __name__ == "__main__":`, or is no file.
    """
    main = sys.modules["__main__"]
    script = getattr(main, "__file__", None)
    if script == "<stdin>":
        raise InputError(
            "A program that is read from standard input cannot start worker processes: save it as "
            "a file, and run that."
        )
    if script is None or main.__spec__ is not None or not Path(script).is_file():
        return  # a notebook, `python -c`, or a module that workers import by its name
    if "__main__" not in Path(script).read_text(encoding="utf-8", errors="replace"):
        raise InputError(
            f"{Path(script).name} starts worker processes, and each imports it again: put "
            'its commands under `if __name__ == "__main__":`.'
        )


def process_context() -> BaseContext:
    """Return the context that starts workers: from a server with eitbench loaded, else anew."""
    check_guarded()
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    # What this process needed its workers will: forked with it, they start a second earlier.
    needed = [name for name in ("torch",) if name in sys.modules]
    context.set_forkserver_preload([PRELOADED, *needed])
    # The server's socket is in there. Who tidies up temporary files may have removed both.
    Path(get_temp_dir()).mkdir(mode=0o700, exist_ok=True)
    resource_tracker.ensure_running()  # unblocks Ctrl-C when it starts, so not further down
    with _environment(PINNED | {SOCKETS: get_temp_dir()}), _interrupts_blocked():
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
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Set variables for a new process, such as those that libraries read when they are loaded."""
    before = {name: os.environ[name] for name in variables if name in os.environ}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in variables:
            del os.environ[name]
        os.environ.update(before)


def _end_server() -> None:
    """End the server, which may no longer be reached; the next worker starts another one."""
    for process in psutil.Process().children():
        with suppress(psutil.Error):
            if any("multiprocessing.forkserver" in word for word in process.cmdline()):
                process.kill()


def _enter(
    connection: Connection,
    run: Connection,
    log: Path | None,
    cores: set[int] | None,
    confinement: Confinement | None,
    environment: dict[str, str],
    serve: Callable[..., None],
    arguments: tuple[Any, ...],
) -> None:
    """Serve in a worker, with a process group, output and temporary files of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    # The server of processes has the environment it was started in, which may be an older one.
    os.environ.clear()
    os.environ.update(environment | PINNED)
    if hasattr(os, "fork"):
        _fork_from_guard(connection, run, confinement)
    else:
        threading.Thread(target=_end_with_run, args=(run, os.getpid()), daemon=True).start()
    if cores is not None:  # nor need its cores be those of the run
        os.sched_setaffinity(0, cores)
    with Path(log or os.devnull).open("a", buffering=1, errors="backslashreplace") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
        sys.stdout = sys.stderr = output
        faulthandler.enable(output)
        if confinement is not None:
            confinement.begin()
        run.send_bytes(READY)
        if hasattr(os, "fork"):
            run.close()  # it is the guard's
        with threadpool_limits(THREADS), suppress(EOFError, ConnectionError):
            serve(connection, *arguments)
        # Nobody asks any more. Once this process is gone, nobody can tell what it started.
        end_tree(os.getpid())


def _fork_from_guard(
    connection: Connection, run: Connection, confinement: Confinement | None
) -> None:
    """Go on in a child, the worker; this process becomes its guard.

    The guard runs no scored code, so none can hold its locks. It ends the worker when the run says
    so or is gone, tells the run how the worker ended, and leaves nothing that came from it.
    """
    tempfile.tempdir = None  # the server's
    folder = tempfile.mkdtemp(prefix="eitbench-")
    os.setsid()  # not ended with the worker's group
    _control(_PR_SET_CHILD_SUBREAPER, 1)  # what the worker started is found below this process
    group = make_group(os.getpid())
    guard, worker = os.getpid(), os.fork()
    if worker == 0:
        if group is not None:
            enter_group(group)
        os.setsid()  # so that what the method starts dies with it
        _control(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != guard:
            os._exit(1)
        with suppress(OSError):  # not on Linux: where memory ends, it is ended before the run
            Path("/proc/self/oom_score_adj").write_text("500", encoding="utf-8")
        os.environ.update(dict.fromkeys(TEMPORARY, folder))
        tempfile.tempdir = folder
        return
    connection.close()
    threading.Thread(target=_end_with_run, args=(run, worker), daemon=True).start()
    ended = [os.waitpid(-1, 0)]
    while ended[-1][0] != worker:
        ended.append(os.waitpid(-1, 0))
    folders = [folder]
    try:
        run.send_bytes(b"%d" % os.waitstatus_to_exitcode(ended[-1][1]))
    except OSError:  # the run is gone, and reads no notes
        folders += [] if confinement is None else [str(confinement.folder)]
    end_tree(worker)
    ended += _end_children()
    for left in folders:
        shutil.rmtree(left, ignore_errors=True)
    if group is not None:
        with suppress(OSError):  # it is left, empty
            group.rmdir()
    for pid, _ in ended:  # by these, OpenMP libraries of LLVM and Intel know that they are loaded
        for file in SHARED_MEMORY.glob(f"__KMP_REGISTERED_LIB_{pid}_*"):
            file.unlink(missing_ok=True)
    os._exit(0)


def _end_with_run(run: Connection, worker: int) -> None:
    """Wait until the run says so or is gone, and end the worker."""
    with suppress(EOFError, OSError):
        run.recv_bytes()
    end_tree(worker)


def _end_children() -> list[tuple[int, int]]:
    """Kill what is below this process until nothing is left; return what `waitpid` says of it."""
    ended = []
    with suppress(ChildProcessError):
        while True:
            for process in psutil.Process().children(recursive=True):
                with suppress(psutil.Error):
                    process.kill()
            while (last := os.waitpid(-1, os.WNOHANG))[0]:
                ended.append(last)
            time.sleep(0.01)
    return ended


def _control(option: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def end_tree(pid: int) -> None:
    """Kill what the worker `pid` started, in its process group or out of it, then the group."""
    with suppress(psutil.Error):
        for process in psutil.Process(pid).children(recursive=True):
            with suppress(psutil.Error):
                process.kill()
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)
