"""A method in its own process: limits, deaths, isolation."""

import operator
import os
import signal
import subprocess
import sys
import threading
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import numpy as np
import psutil
import pytest
from tests.support.waiting import has_ended, wait_for

from eitbench.benchmark.workers import method_service
from eitbench.benchmark.workers.messages import MAX_HEADER, MAX_TRACE, Reply, WorkerLostError
from eitbench.benchmark.workers.method_service import MethodService, learning_splits
from eitbench.benchmark.workers.process import WorkerProcess
from eitbench.benchmark.workers.worker import (
    StoppedError,
    Worker,
    describe_exception,
    plugin_names,
    serve,
)
from eitbench.methods.method import DRAWS, Method
from eitbench.methods.problem import Problem
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.data.datasets import Dataset, load
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.suites.suite import Suite

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


def fitted(
    suite: Suite, data: Dataset, method: str, plugin: Path, stop: threading.Event | None = None
) -> Worker:
    splits = partial(learning_splits, suite.scenarios[0])
    service = MethodService(data.sensor, data.references[0], splits, method, {}, plugin)
    worker = Worker(serve, service, stop=stop)
    reply = worker.ask("set_up", limit=60, what="set-up")
    assert reply.failure is None
    return worker


@pytest.mark.slow
def test_a_stopped_run_does_not_wait_for_a_method(tiny: Suite, data: Dataset, toys: Path) -> None:
    stop = threading.Event()
    frame = data.voltages[:1], data.references[:1]
    with fitted(tiny, data, "toy-hangs", toys, stop=stop) as worker:
        threading.Timer(0.1, stop.set).start()
        with pytest.raises(StoppedError):
            worker.ask("reconstruct", *frame, limit=600, what="a frame")


def test_one_thread_own_environment_no_orphans_no_test_split(
    tiny: Suite, data: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = tmp_path / "spy.py"
    plugin.write_text(SPY)
    # Set after worker processes have been started before: the server of processes is older.
    monkeypatch.setenv("SPY", "42")
    frame = data.voltages[:1], data.references[:1]
    with fitted(tiny, data, "spy", plugin) as worker:
        seen = worker.ask("reconstruct", *frame, limit=60, what="it").value[0, 0, :4]
    threads, environment, child, knows_test = seen
    assert threads == 1
    assert environment == 42
    assert not knows_test
    wait_for(lambda: has_ended(int(child)))


def test_a_service_gives_each_frame_its_own_reference_frame(tiny: Suite, data: Dataset) -> None:
    """In one request: the images are those of services that begin with that reference frame."""
    splits = partial(learning_splits, tiny.scenarios[0])
    service = MethodService(data.sensor, data.references[0], splits, "noser", {})
    service.fitted({})  # `set_up` would close the test split of this process
    changes = data.voltages[:4] - data.references[:4]
    references = data.references[:4].copy()
    references[1:3] *= 1.5
    reply = service.reconstruct(references + changes, references)
    assert reply.failure is None
    assert reply.value.dtype == np.float32
    for k in range(4):
        fresh = MethodService(data.sensor, references[k], splits, "noser", {})
        fresh.fitted({})
        alone = fresh.reconstruct((references + changes)[k : k + 1], references[k : k + 1])
        np.testing.assert_allclose(reply.value[k], alone.value[0], atol=1e-5)
    none = np.empty((0, data.sensor.n_measurements))
    assert service.reconstruct(none, none).value.shape == (0, *data.sensor.image_shape)


def test_what_is_stated_has_one_shape_for_all_sessions(
    tiny: Suite, data: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A deviation (1, H, W) would otherwise fill all draws of the one frame of a session."""

    class Wavering(Method):
        def fit(self, problem: Problem) -> None:
            self.image, self.calls = np.ones(problem.sensor.image_shape), 0

        def reconstruct(self, voltages: Array) -> Array:
            return np.repeat(self.image[None], len(voltages), axis=0)

        def uncertainty(self, voltages: Array) -> Array:
            self.calls += 1
            images = self.reconstruct(voltages)
            return np.repeat(images[:, None], DRAWS, axis=1) if self.calls == 1 else images

    wavering, splits = Wavering(), partial(learning_splits, tiny.scenarios[0])
    service = MethodService(data.sensor, data.references[0], splits, "wavering", {})
    monkeypatch.setattr(method_service, "create", lambda _: wavering)
    service.fitted({})
    references = data.references[:2] * np.array([[1.0], [1.1]])
    height, width = data.sensor.image_shape
    reply = service.reconstruct_and_state(data.voltages[:1], references[:1])
    assert reply.value["uncertainty"].shape == (1, DRAWS, height, width)
    wavering.calls = 0
    reply = service.reconstruct_and_state(data.voltages[:2], references)
    assert reply.failure is not None
    assert reply.failure.message == (
        f"uncertainty returned an array of shape (1, {height}, {width}) instead of "
        f"(1, {DRAWS}, {height}, {width})"
    )


def test_a_method_is_never_given_the_test_split(tiny: Suite) -> None:
    assert len(learning_splits(tiny.scenarios[0], "validation", 2)) == 2
    with pytest.raises(InputError, match="not for 'test'"):
        learning_splits(tiny.scenarios[0], "test", 2)


IMPORTS = "from eitbench.methods import Method, register\n"


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("import no_such_module", "No module named 'no_such_module'"),
        ("x = (", "SyntaxError"),
        ("x = 1", "registers nothing: decorate a class"),
        (f"{IMPORTS}@register\nclass A(Method): pass", 'write @register."my-name".'),
        (f"{IMPORTS}@register('a')\nclass A(Method): pass", "A of 'a' lacks fit and reconstruct"),
        ("import beside", "A plugin is one file: put its modules into it"),
        ("raise SystemExit(5)", "does not run: SystemExit: 5"),
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("import os; os._exit(3)", "exit code 3"),
    ],
)
def test_a_bad_plugin_is_said_in_a_sentence(source: str, sentence: str, tmp_path: Path) -> None:
    plugin = tmp_path / "bad.py"
    plugin.write_text(source)
    (tmp_path / "beside.py").touch()
    with pytest.raises(InputError, match=sentence):
        plugin_names(plugin)


def test_plugins_are_loaded_elsewhere(toys: Path, capfd: pytest.CaptureFixture[str]) -> None:
    before = dict(os.environ)
    assert "toy-good" in plugin_names(toys).methods
    assert capfd.readouterr().out == ""
    assert dict(os.environ) == before
    from eitbench.methods import methods

    assert "toy-good" not in methods()


@pytest.mark.parametrize("ended", [False, True])
def test_an_answer_that_is_none_loses_the_worker(ended: bool) -> None:
    sentence = "sent something that is no answer during it"
    with Worker(operator.methodcaller("send", "nonsense")) as worker:
        if ended:  # before it was asked
            assert worker._process.sentinel.poll(60)
        with pytest.raises(WorkerLostError, match=sentence) as lost:
            worker.ask("fit", limit=60, what="it")
    assert lost.value.failure.status == "error"


def test_an_object_is_no_answer_and_its_code_is_not_run(tmp_path: Path) -> None:
    """As multiprocessing would send it: unpickled, it makes a folder."""
    made = tmp_path / "made"
    message = bytes(ForkingPickler.dumps(MakesFolder(made)))
    with (
        Worker(operator.methodcaller("send_bytes", message)) as worker,
        pytest.raises(WorkerLostError, match="sent something that is no answer during it"),
    ):
        worker.ask("fit", limit=60, what="it")
    assert not made.exists()


def test_half_an_answer_is_not_waited_for_without_end() -> None:
    with (
        Worker(send_half) as worker,
        pytest.raises(WorkerLostError, match=r"it took longer than 0.5 s") as lost,
    ):
        worker.ask("fit", limit=0.5, what="it")
    assert lost.value.failure.status == "timeout"


class Answers:
    def say(self) -> Reply:
        return Reply("done", 0.0, None, 0.0)


def test_an_answer_that_comes_as_the_time_is_up_is_late_and_costs_no_other_request() -> None:
    with Worker(serve, Answers()) as worker:
        assert worker.ask("say", limit=60, what="it").value == "done"
        end = worker._end_late
        worker._process.end = lambda: None  # type: ignore[method-assign]
        end()  # as its timer does between the answer and its reading
        with pytest.raises(WorkerLostError, match="it took longer than 60 s"):
            worker.ask("say", limit=60, what="it")
        del worker._process.end


class MakesFolder:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.path),)


def send_half(connection: Connection) -> None:
    """Send less than was said, then nothing."""
    os.write(connection.fileno(), (1000).to_bytes(4, "big") + b"half")
    connection.recv()
    connection.recv()


def send_long(connection: Connection) -> None:
    """Send more than a header may have, then nothing."""
    connection.recv()
    connection.send_bytes(bytes(MAX_HEADER + 1))
    connection.recv()


def test_the_limit_ends_no_worker_whose_death_is_looked_into(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Or its end would be taken for the worker's own, such as by a lack of memory."""
    waiting: list[threading.Timer] = []

    def exit_code(_: WorkerProcess) -> None:
        timers = [of for of in threading.enumerate() if isinstance(of, threading.Timer)]
        waiting.extend(of for of in timers if not of.finished.is_set())

    monkeypatch.setattr(WorkerProcess, "exit_code", exit_code)
    with (
        Worker(send_long) as worker,
        pytest.raises(WorkerLostError, match="sent something that is no answer"),
    ):
        worker.ask("anything", limit=600, what="it")
    assert waiting == []


class MuteError(Exception):
    def __str__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ValueError("\ud800"), "ValueError: \\ud800"),
        (ValueError("x" * 1000), "ValueError: " + "x" * 487 + "…"),
        (MuteError(), "MuteError: (its message cannot be printed)"),
    ],
)
def test_any_message_can_be_written(error: Exception, message: str) -> None:
    assert describe_exception(error).message == message
    assert len(message.encode()) <= 510


REGISTERS = """
from eitbench.methods import Method, register

@register({!r})
class Mine(Method):
    def fit(self, problem): ...
    def reconstruct(self, voltages): ...
"""


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("noser", "'noser' is taken"),
        ("ü" * 41, "cannot name a method: use 1 to 80 bytes"),
        ("truth", "cannot name a method"),  # result files use it
        ("..", "cannot name a method"),
    ],
)
def test_a_plugin_cannot_have_any_name(name: str, sentence: str, tmp_path: Path) -> None:
    plugin = tmp_path / "plugin.py"
    plugin.write_text(REGISTERS.format("ü" * 40), encoding="utf-8")
    assert list(plugin_names(plugin).methods) == ["ü" * 40]
    plugin.write_text(REGISTERS.format(name), encoding="utf-8")
    with pytest.raises(InputError, match=sentence):
        plugin_names(plugin)


def test_the_frames_of_a_plugin_are_told_with_those_of_the_cause(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("def read(path):\n    return open(path)\n")
    plugin = tmp_path / "fails.py"
    plugin.write_text(
        f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\nfrom helper import read\ntry:\n"
        "    read('nowhere')\nexcept OSError as error:\n    raise ValueError('no') from error\n"
    )
    with pytest.raises(InputError, match="does not run: ValueError: no") as raised:
        plugin_names(plugin)
    (note,) = raised.value.__notes__
    assert [line for line in note.splitlines() if set(line) - set(" ~^")] == [
        '  File "fails.py", line 5, in <module>',
        "    read('nowhere')",
        '  File "helper.py", line 2, in read',
        "    return open(path)",
        "which led to:",
        '  File "fails.py", line 7, in <module>',
        "    raise ValueError('no') from error",
    ]


def test_a_long_trace_keeps_its_ends_and_our_own_refusals_have_none() -> None:
    def deep(n: int) -> None:
        (lambda: deep(n + 1))()

    with pytest.raises(RecursionError) as raised:
        deep(0)
    trace = describe_exception(raised.value).trace
    assert len(trace) <= MAX_TRACE
    assert trace.startswith('  File "tests/benchmark/workers/test_worker.py"')
    assert "\n…" in trace
    with pytest.raises(InputError) as refused:
        load("quick", "nothing")
    refused.value.__traceback__ = refused.tb.tb_next  # without this test's frame
    assert describe_exception(refused.value).trace == ""


@pytest.mark.slow
def test_a_script_is_told_about_the_guard_before_anything_is_run(tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(
        "from eitbench.benchmark.workers.worker import plugin_names\nplugin_names('any.py')\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].endswith(
        "mine.py starts worker processes, and each imports it again: put its commands under "
        '`if __name__ == "__main__":`.'
    )


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc: run on Linux")
def test_ctrl_c_does_not_reach_what_a_run_starts(toys: Path) -> None:
    plugin_names(toys)
    with Worker(operator.methodcaller("recv")) as worker:
        process = psutil.Process(worker._process.pid)
        for pid in (process.pid, process.ppid()):
            status = Path(f"/proc/{pid}/status").read_text()
            masks = dict(line.split(":", 1) for line in status.splitlines())
            assert int(masks["SigBlk"], 16) & 1 << (signal.SIGINT - 1)
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.slow
def test_a_program_from_standard_input_is_told_to_be_a_file() -> None:
    program = "from eitbench.benchmark.workers.worker import plugin_names\nplugin_names('any.py')\n"
    done = subprocess.run([sys.executable, "-"], input=program, capture_output=True, text=True)
    assert done.returncode == 1
    assert "save it as a file, and run that." in done.stderr.splitlines()[-1]
