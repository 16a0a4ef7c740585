"""A cluster of separate processes gives the bits of one machine, also when one of them is lost."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

pytest.importorskip("distributed")

from distributed import Client
from tests.support.waiting import wait_for

from eitbench.benchmark.run import executors as execution
from eitbench.benchmark.run.runner import (
    Plan,
    RunInterruptedError,
    make_plan,
    resume_run,
    start_run,
)
from eitbench.benchmark.rundir import manifest
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.suites.suite import Suite, load_suite

pytestmark = pytest.mark.slow

SameResults = Callable[[Path, Path], None]
START_SECONDS = 120


class Machines:
    """A scheduler and two machines with one thread each, all processes of their own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        scheduler = folder / "scheduler.json"
        self._scheduler = self._start("scheduler", "--port", "0", "--no-dashboard")
        self.workers = [self._start("worker", "--nthreads", "1", "--no-nanny") for _ in range(2)]
        wait_for(scheduler.is_file)
        self.client = Client(scheduler_file=str(scheduler), set_as_default=False)
        self.client.wait_for_workers(2, timeout=START_SECONDS)
        self.address: str = self.client.scheduler.address

    def _start(self, role: str, *options: str) -> subprocess.Popen[bytes]:
        file = ["--scheduler-file", str(self._folder / "scheduler.json")]
        place = ["--local-directory", str(self._folder)] if role == "worker" else []
        command = [sys.executable, "-m", "distributed.cli.dask_" + role, *file, *place, *options]
        with (self._folder / f"{role}.log").open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, cwd=self._folder)

    def busy(self) -> list[int]:
        """Machines that run a method: their servers of processes have started one."""
        living = [psutil.Process(worker.pid) for worker in self.workers if worker.poll() is None]
        return [m.pid for m in living if len(m.children(recursive=True)) > len(m.children())]

    def once_busy(self, act: Callable[[int], object]) -> threading.Thread:
        """Call `act` with the process of a machine as soon as it runs a method."""

        def wait() -> None:
            act(wait_for(self.busy)[0])

        thread = threading.Thread(target=wait)
        thread.start()
        return thread

    def end_scheduler(self) -> None:
        """Leave the machines without one."""
        self._scheduler.kill()

    def end(self) -> None:
        self.client.close()
        for process in (*self.workers, self._scheduler):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    found = Machines(tmp_path_factory.mktemp("cluster"))
    yield found
    found.end()


def longer(suite: Suite) -> Suite:
    """Some seconds of work for a method that takes its time."""
    (scenario,) = suite.scenarios
    return suite.model_copy(update={"scenarios": (scenario.model_copy(update={"test": 20}),)})


@pytest.fixture(scope="module")
def plan(tiny: Suite, toys: Path) -> Plan:
    return make_plan(longer(tiny), methods=["noser", "toy-nan", "toy-slow"], plugins=[toys])


@pytest.fixture(scope="module")
def here(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return start_run(plan, tmp_path_factory.mktemp("runs") / "here").path


@pytest.fixture
def by_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    """A remote task for each batch."""
    monkeypatch.setattr(execution, "REMOTE_TASK_SECONDS", 0.0)


@pytest.mark.usefixtures("by_batch")
def test_a_cluster_gives_the_same_bits_batch_by_batch(
    machines: Machines,
    plan: Plan,
    here: Path,
    same_results: SameResults,
    tmp_path: Path,
) -> None:
    there = start_run(plan, tmp_path / "there", scheduler=machines.address).path
    same_results(here, there)
    assert (there / "logs" / "tiny--toy-nan.log").is_file()


@pytest.mark.nightly
def test_a_cluster_has_what_operators_are_compared_with(
    machines: Machines, same_results: SameResults, tmp_path: Path
) -> None:
    suite = load_suite(Path(__file__).parents[1] / "data" / "tiny-operators.toml")
    plan = make_plan(suite, scenarios=["tiny-same"], limit=2)
    one = start_run(plan, tmp_path / "here").path
    same_results(one, start_run(plan, tmp_path / "there", scheduler=machines.address).path)


@pytest.mark.usefixtures("by_batch")
def test_what_a_cluster_finished_is_kept_and_the_run_goes_on_here(
    machines: Machines,
    plan: Plan,
    here: Path,
    same_results: SameResults,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answer = execution.DaskExecutor._answer
    answered: list[execution.RemoteResult] = []

    def fails_in_the_end(*given: object) -> object:
        if len(answered) >= 3:  # several cells ask at a time
            raise EitbenchError("The cluster is gone.")
        answered.append(answer(*given))  # type: ignore[arg-type]
        return answered[-1]

    with monkeypatch.context() as patch:
        patch.setattr(execution.DaskExecutor, "_answer", fails_in_the_end)
        with pytest.raises(EitbenchError, match="The cluster is gone"):
            start_run(plan, tmp_path / "run", scheduler=machines.address)
    assert list((tmp_path / "run" / "parts").rglob("test-*.npz"))
    resume_run(tmp_path / "run")
    same_results(here, tmp_path / "run")


def test_another_version_on_the_cluster_is_refused(
    machines: Machines, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = manifest.versions()
    monkeypatch.setattr(manifest, "versions", lambda: ours | {"numpy": "1.0"})
    with pytest.raises(EitbenchError, match="has another version of numpy than this one"):
        start_run(plan, tmp_path / "run", scheduler=machines.address)


def test_a_scheduler_that_does_not_answer_is_one_sentence(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "CONNECT_SECONDS", 0.5)
    with pytest.raises(InputError, match=r"No Dask scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        start_run(plan, tmp_path / "run", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match=r"an address such as tcp://10\.0\.0\.1:8786, got 'near'"):
        start_run(plan, tmp_path / "run", scheduler="near")
    assert not (tmp_path / "run").exists()


def test_what_is_stopped_here_stops_there(
    machines: Machines, tiny: Suite, toys: Path, tmp_path: Path
) -> None:
    hanging = make_plan(
        tiny.model_copy(update={"frame_limit_s": 600.0}), methods=["toy-hangs"], plugins=[toys]
    )
    out = tmp_path / "run"
    machines.once_busy(lambda _: os.kill(os.getpid(), signal.SIGINT))
    with pytest.raises(RunInterruptedError):
        start_run(hanging, out, scheduler=machines.address)
    wait_for(lambda: not machines.busy())


def test_a_machine_that_is_lost_costs_nothing(
    machines: Machines, plan: Plan, here: Path, same_results: SameResults, tmp_path: Path
) -> None:
    """The last test but one: the cluster has one machine less afterwards."""
    killer = machines.once_busy(lambda machine: os.kill(machine, signal.SIGKILL))
    there = start_run(plan, tmp_path / "there", scheduler=machines.address).path
    killer.join()
    assert sum(process.poll() is not None for process in machines.workers) == 1
    same_results(here, there)


def test_a_scheduler_that_ends_is_one_sentence_and_loses_nothing(
    machines: Machines, plan: Plan, tmp_path: Path
) -> None:
    """The last test: there is no cluster afterwards."""
    machines.once_busy(lambda _: machines.end_scheduler())
    with pytest.raises(EitbenchError, match=r"no longer answers\. .*eitbench run --resume"):
        start_run(plan, tmp_path / "run", scheduler=machines.address)
