"""Worker processes end with their run, leave nothing behind, and start again when that fails."""

import operator
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import forkserver
from multiprocessing.context import ForkServerProcess
from multiprocessing.util import get_temp_dir
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.support.waiting import has_ended, wait_for

from eitbench.benchmark.run.runner import make_plan, resume_run, start_run
from eitbench.benchmark.workers import process as processes
from eitbench.benchmark.workers.messages import WorkerLostError
from eitbench.benchmark.workers.worker import Worker, _PluginReader, serve
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.suites.suite import Suite

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork: run on Linux or macOS")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="needs prctl: run on Linux")

NOTES_PID = """
import ctypes, os, signal, subprocess, tempfile, time
from pathlib import Path

def note(name, text):
    path = Path(__file__).with_suffix(name)
    path.with_suffix(".part").write_text(str(text))
    path.with_suffix(".part").replace(path)

def daemon():
    # A process in a session of its own, whose parent has ended.
    if (child := os.fork()) == 0:
        os.setsid()
        if os.fork() == 0:
            note(".daemon", os.getpid())
            time.sleep(1000)
        os._exit(0)
    os.waitpid(child, 0)
    while not Path(__file__).with_suffix(".daemon").exists():
        time.sleep(0.01)

note(".temp", tempfile.mkdtemp())
"""
ENDURES = {
    "stopped": "daemon(); note('.pid', os.getpid()); os.kill(os.getpid(), signal.SIGSTOP)",
    "locked": "daemon(); note('.pid', os.getpid()); ctypes.PyDLL(None).sleep(1000)",
    "deaf": "for n in (1, 2, 15): signal.signal(n, signal.SIG_IGN)\n"
    "daemon(); note('.pid', os.getpid()); time.sleep(1000)",
}
ASKS_FOR_EVER = """
import sys, threading
from pathlib import Path
from eitbench.benchmark.workers.worker import Worker, _PluginReader, serve

def ask(plugin):
    Worker(serve, _PluginReader(Path(plugin))).ask("names", limit=1000, what="it")

if __name__ == "__main__":
    for plugin in sys.argv[1:]:
        threading.Thread(target=ask, args=(plugin,)).start()
"""


def noted(plugin: Path, name: str) -> str:
    path = plugin.with_suffix(name)
    return str(wait_for(lambda: path.exists() and path.read_text()))


@pytest.mark.slow
@LINUX
def test_no_worker_outlives_a_run_that_is_killed(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Whatever its workers do meanwhile; neither do their daemons and temporary files."""
    plugins = [tmp_path / f"{name}.py" for name in ENDURES]
    for plugin in plugins:
        plugin.write_text(NOTES_PID + ENDURES[plugin.stem])
    temporary = tmp_path_factory.mktemp("t")  # the path of a socket has 107 bytes at most
    run = subprocess.Popen(
        [sys.executable, "-c", ASKS_FOR_EVER, *map(str, plugins)],
        env=os.environ | {"TMPDIR": str(temporary)},
    )
    pids = [int(noted(plugin, name)) for plugin in plugins for name in (".pid", ".daemon")]
    assert not any(map(has_ended, pids))
    assert list(temporary.iterdir())
    run.kill()
    run.wait()
    wait_for(lambda: all(map(has_ended, pids)), 30)
    wait_for(lambda: not list(temporary.iterdir()), 30)


FORKS_ON = """
import fcntl, os, time
from pathlib import Path

held = open(Path(__file__).with_suffix(".lock"), "w")
fcntl.flock(held, fcntl.LOCK_EX)
if os.fork() == 0:
    os.setsid()
    last = time.monotonic() + 60
    while time.monotonic() < last:  # each link of the chain starts the next one and ends
        if os.fork():
            os._exit(0)
        os.setsid()
    os._exit(0)
"""


@LINUX
@pytest.mark.parametrize("end", ["", "os._exit(3)"])
def test_a_chain_of_processes_is_ended(end: str, tmp_path: Path) -> None:
    """Each in a session of its own, whose parent has ended; the worker may have ended first."""
    plugin = tmp_path / "chain.py"
    plugin.write_text(FORKS_ON + end)
    with Worker(serve, _PluginReader(plugin)) as worker, suppress(WorkerLostError):
        worker.ask("names", limit=60, what="it")
    fcntl = pytest.importorskip("fcntl")  # not on Windows
    with plugin.with_suffix(".lock").open() as lock:
        # All that are forked hold it.
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


@LINUX
def test_temporary_files_of_a_worker_go_with_it(tmp_path: Path) -> None:
    """Also the file in shared memory by which an OpenMP library knows that it is loaded."""
    plugin = tmp_path / "temporary.py"
    library = "f'/dev/shm/__KMP_REGISTERED_LIB_{os.getpid()}_{os.getuid()}'"
    plugin.write_text(NOTES_PID + f"note('.kmp', {library}); Path({library}).touch(); os.abort()")
    with Worker(serve, _PluginReader(plugin)) as worker, pytest.raises(WorkerLostError):
        worker.ask("names", limit=60, what="it")
    folder = Path(noted(plugin, ".temp"))
    assert folder.is_relative_to(tempfile.gettempdir())
    assert not folder.exists()
    assert not Path(noted(plugin, ".kmp")).exists()


def server() -> psutil.Process:
    """The process that workers are forked by."""
    return psutil.Process(vars(forkserver)["_forkserver"]._forkserver_pid)


@LINUX
def test_a_worker_has_the_cores_of_its_run_and_not_of_the_server(tmp_path: Path) -> None:
    plugin = tmp_path / "plugin.py"
    plugin.write_text("")
    before = sorted(os.sched_getaffinity(0))
    for core, cores in ((None, before), (before[0], before[:1]), (None, before)):
        process, connection = processes.start_process(serve, (_PluginReader(plugin),), None, core)
        try:
            (worker,) = psutil.Process(process.pid).children()  # of its guard
            assert worker.cpu_affinity() == cores
        finally:
            connection.close()
            process.end()
            server().cpu_affinity(before[-1:])
    server().cpu_affinity(before)


@pytest.fixture(scope="module")
def undisturbed(tiny: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    plan = make_plan(tiny, methods=["noser"])
    return start_run(plan, tmp_path_factory.mktemp("undisturbed") / "run").path


@pytest.mark.slow
@LINUX
def test_a_server_that_is_killed_costs_no_row(
    tiny: Suite,
    tmp_path: Path,
    undisturbed: Path,
    monkeypatch: pytest.MonkeyPatch,
    same_results: Callable[[Path, Path], None],
) -> None:
    """Neither while a worker is busy, nor before the next one is started."""
    killed: list[psutil.Process] = []
    ask = Worker.ask

    def asked(self: Worker, operation: str, *request: object, **options: Any) -> Any:
        if operation in ("times", "reconstruct_and_state") and not killed:
            process = server()
            process.kill()
            wait_for(lambda: has_ended(process.pid))
            killed.append(process)
        return ask(self, operation, *request, **options)

    monkeypatch.setattr(Worker, "ask", asked)
    plan = make_plan(tiny, methods=["noser"])
    same_results(undisturbed, start_run(plan, tmp_path / "run").path)
    assert killed
    with Worker(operator.methodcaller("recv")):
        assert server() not in killed


@pytest.mark.slow
@LINUX
def test_a_worker_starts_though_the_socket_of_the_server_is_gone() -> None:
    """As where somebody tidies up temporary files."""
    with Worker(operator.methodcaller("recv")):
        before = server()
    shutil.rmtree(get_temp_dir())
    with Worker(operator.methodcaller("recv")):
        assert server() != before


def test_a_run_that_can_start_no_worker_ends_and_is_resumed(
    tiny: Suite,
    tmp_path: Path,
    undisturbed: Path,
    monkeypatch: pytest.MonkeyPatch,
    same_results: Callable[[Path, Path], None],
) -> None:
    plan = make_plan(tiny, methods=["noser"])
    with monkeypatch.context() as patch:

        def refused(self: ForkServerProcess) -> None:
            raise ConnectionRefusedError("Connection refused")

        patch.setattr(ForkServerProcess, "start", refused)
        patch.setattr(processes, "_end_server", lambda: None)
        patch.setattr(processes, "PAUSES", (0.0, 0.0))
        with pytest.raises(EitbenchError, match=r"No worker.*refused.*--resume"):
            start_run(plan, tmp_path / "run")
    assert not list((tmp_path / "run").glob("parts/*/*/*"))
    same_results(undisturbed, resume_run(tmp_path / "run").path)


def test_a_worker_that_ends_before_it_is_ready_is_no_death_of_scored_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "PAUSES", (0.0,))
    with pytest.raises(EitbenchError, match=r"No worker .* \(it ends at once\)"):
        Worker(operator.methodcaller("recv"), log=tmp_path / "no-folder" / "log")


@pytest.mark.slow
@LINUX
def test_where_memory_ends_a_worker_is_ended_before_the_run() -> None:
    own = int(Path("/proc/self/oom_score_adj").read_text())
    with Worker(operator.methodcaller("recv")) as worker:
        (process,) = psutil.Process(worker._process.pid).children()
        assert int(Path(f"/proc/{process.pid}/oom_score_adj").read_text()) > own
