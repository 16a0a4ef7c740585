"""A method in its own process: limits, deaths, isolation."""

import os
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from eitbench.benchmark.worker import (
    Failure,
    Reply,
    StoppedError,
    Task,
    Worker,
    WorkerLostError,
    learning_splits,
    plugin_methods,
    scenario_splits,
    serve_method,
)
from eitbench.scenarios.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites import Suite

SPY = """
import os, subprocess, sys
import numpy as np
from threadpoolctl import threadpool_info
from eitbench.methods import Method, register

@register("spy")
class Spy(Method):
    def fit(self, problem):
        self.problem = problem

    def reconstruct(self, voltages):
        threads = max([pool["num_threads"] for pool in threadpool_info()], default=1)
        child = subprocess.Popen(["sleep", "600"]).pid
        images = np.ones((len(voltages), *self.problem.mask.shape))
        images[0, 0, :4] = threads, float(os.environ["SPY"]), child, hasattr(self.problem, "test")
        return images
"""


@pytest.fixture(scope="module")
def data(tiny: Suite) -> Dataset:
    return load(tiny.scenarios[0])


def task(suite: Suite, data: Dataset, method: str, plugin: Path) -> Task:
    splits = scenario_splits(suite.scenarios[0])
    return Task(data.sensor, data.reference, splits, method, {}, (plugin,))


def fitted(
    suite: Suite, data: Dataset, method: str, plugin: Path, stop: threading.Event | None = None
) -> Worker:
    worker = Worker(serve_method, task(suite, data, method, plugin), stop=stop)
    reply: Reply = worker.ask("fit", limit=60, what="fit")
    assert reply.failure is None
    return worker


def test_images_come_back_as_float32(tiny: Suite, data: Dataset, toys: Path) -> None:
    with fitted(tiny, data, "toy-good", toys) as worker:
        reply = worker.ask("reconstruct", data.voltages, limit=60, what="it")
    assert reply.failure is None
    assert reply.value.shape == (5, 40, 40)
    assert reply.value.dtype == np.float32
    assert reply.seconds > 0
    assert reply.memory_mb > 10


def test_a_hanging_method_is_given_up(tiny: Suite, data: Dataset, toys: Path) -> None:
    with fitted(tiny, data, "toy-hangs", toys) as worker:
        with pytest.raises(WorkerLostError, match=r"a frame took longer than 0\.2 s") as lost:
            worker.ask("reconstruct", data.voltages[:1], limit=0.2, what="a frame")
        assert lost.value.failure.status == "timeout"


def test_a_killed_process_ran_out_of_memory(tiny: Suite, data: Dataset, toys: Path) -> None:
    with (
        fitted(tiny, data, "toy-killed", toys) as worker,
        pytest.raises(WorkerLostError) as lost,
    ):
        worker.ask("reconstruct", data.voltages, limit=60, what="a batch")
    assert lost.value.failure == Failure(
        "out-of-memory", "its process was killed (SIGKILL) during a batch"
    )


def test_a_stopped_run_does_not_wait_for_a_method(tiny: Suite, data: Dataset, toys: Path) -> None:
    stop = threading.Event()
    with fitted(tiny, data, "toy-hangs", toys, stop=stop) as worker:
        threading.Timer(0.1, stop.set).start()
        with pytest.raises(StoppedError):
            worker.ask("reconstruct", data.voltages[:1], limit=600, what="a frame")


def test_one_thread_own_environment_no_orphans_no_test_split(
    tiny: Suite, data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = tmp_path / "spy.py"
    plugin.write_text(SPY)
    # Set after worker processes have been started before: the server of processes is older.
    monkeypatch.setenv("SPY", "42")
    with fitted(tiny, data, "spy", plugin) as worker:
        seen = worker.ask("reconstruct", data.voltages[:1], limit=60, what="it").value[0, 0, :4]
    threads, environment, child, knows_test = seen
    assert threads == 1
    assert environment == 42
    assert not knows_test
    for _ in range(100):
        if not psutil.pid_exists(int(child)) or _is_zombie(int(child)):
            break
        time.sleep(0.05)
    else:
        pytest.fail("a process that the method started survives it")


def _is_zombie(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_a_method_is_never_given_the_test_split(tiny: Suite) -> None:
    assert len(learning_splits(tiny.scenarios[0], "validation", 2)) == 2
    with pytest.raises(InputError, match="not for 'test'"):
        learning_splits(tiny.scenarios[0], "test", 2)


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("import no_such_module", "No module named 'no_such_module'"),
        ("x = (", "SyntaxError"),
        ("x = 1", "registers no method"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("import os; os._exit(3)", "exit code 3"),
    ],
)
def test_a_bad_plugin_is_said_in_a_sentence(source: str, sentence: str, tmp_path: Path) -> None:
    plugin = tmp_path / "bad.py"
    plugin.write_text(source)
    with pytest.raises(InputError, match=sentence):
        plugin_methods(plugin)


def test_plugins_are_loaded_elsewhere(toys: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = dict(os.environ)
    assert "toy-good" in plugin_methods(toys)
    assert capfd.readouterr().out == ""
    assert dict(os.environ) == before
    from eitbench.methods import methods

    assert "toy-good" not in methods()
