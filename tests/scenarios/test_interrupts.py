"""SIGTERM and SIGHUP interrupt once, as Ctrl-C does; processes end with who started them."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest
from tests.support.waiting import has_ended, wait_for

from eitbench.scenarios.interrupts import termination_interrupts

if not hasattr(signal, "SIGHUP"):
    pytest.skip("this system has no SIGHUP", allow_module_level=True)
ENDS = [signal.SIGTERM, signal.SIGHUP]


@pytest.mark.parametrize("number", ENDS)
def test_a_signal_interrupts_once_so_that_all_is_stored(number: signal.Signals) -> None:
    before, stored = signal.getsignal(number), []

    def work() -> None:
        with termination_interrupts():
            try:
                os.kill(os.getpid(), number)
            finally:  # a terminal that is closed sends more than one
                for again in ENDS:
                    os.kill(os.getpid(), again)
                stored.append(True)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert stored
    assert signal.getsignal(number) is before


def test_an_ignored_signal_stays_ignored() -> None:
    """As `nohup` leaves it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with termination_interrupts():
            os.kill(os.getpid(), signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_outside_the_main_thread_nothing_changes() -> None:
    before, found = signal.getsignal(signal.SIGTERM), []

    def work() -> None:
        with termination_interrupts():
            found.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [before]


def test_a_worker_whose_parent_has_gone_before_ends_at_once() -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    code = "import sys; from eitbench.scenarios.interrupts import end_with_parent; " + (
        "end_with_parent(int(sys.argv[1])); print('works')"
    )
    for pid, says in ((os.getpid(), "works\n"), (os.getppid(), ""), (gone.pid, "")):
        worker = [sys.executable, "-c", code, str(pid)]
        ended = subprocess.run(worker, capture_output=True, text=True, check=False)
        assert (ended.stdout, ended.returncode) == (says, int(not says)), ended.stderr


TINY = Path(__file__).parents[1] / "benchmark" / "data" / "tiny.toml"
SIMULATES = """
import sys
from pathlib import Path
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.suites.suite import load_suite

if __name__ == "__main__":
    load(load_suite(Path(sys.argv[1])).scenarios[0], split="train", jobs=2)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks at /dev/shm: run on Linux")
def test_a_simulation_that_is_killed_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    suite = tmp_path / "many.toml"
    suite.write_text(TINY.read_text().replace("train = 4", "train = 30000"))
    run = subprocess.Popen([sys.executable, "-c", SIMULATES, str(suite)])
    # Both simulate.
    wait_for(lambda: len(list((tmp_path / "cache").rglob("*.safetensors"))) >= 2)
    children = [process.pid for process in psutil.Process(run.pid).children(recursive=True)]
    run.kill()
    run.wait()
    wait_for(lambda: all(map(has_ended, children)), 30)
    assert not list(Path("/dev/shm").glob(f"*loky-{run.pid}-*"))  # noqa: S108
    assert not list(Path("/dev/shm").glob(f"joblib*_{run.pid}_*"))  # noqa: S108
