"""Whatever a plugin does to its process costs its own rows only."""

import os
import signal
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from tests.support.waiting import has_ended, wait_for

from eitbench.benchmark.run.runner import make_plan, start_run
from eitbench.benchmark.workers.process import start_process
from eitbench.benchmark.workers.worker import LOG_HEAD, LOG_LIMIT, _PluginReader, serve
from eitbench.scenarios.suites.suite import Suite

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork: run on Linux or macOS")
SIGRTMIN = getattr(signal, "SIGRTMIN", 0)  # macOS has none
HOSTILE = Path(__file__).parents[1] / "data" / "hostile_methods.py"


@pytest.fixture(scope="module")
def run(tiny: Suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of every hostile method, two at a time, beside one that behaves."""
    folder = tmp_path_factory.mktemp("hostile")
    limits = {"frame_limit_s": 30.0, "memory_limit_mb": 1000.0, "limit": 2}
    plan = make_plan(tiny.model_copy(update=limits), plugins=[HOSTILE])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOSTILE_RUN", str(os.getpid()))
        return start_run(plan, folder / "run", jobs=2).path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "status", "message"),
    [
        ("noser", "ok", ""),
        ("behaves", "ok", ""),
        ("segfaults", "error", "died of SIGSEGV"),
        ("dies-of-a-signal", "error", f"died of signal {SIGRTMIN + 6}"),
        ("is-killed", "out-of-memory", "its process was killed (out of memory, or by hand)"),
        ("kills-its-guard", "out-of-memory", "its process was killed (out of memory, or by hand)"),
        ("kills-the-server", "ok", ""),
        ("takes-memory", "out-of-memory", "took more than 1000 MB of memory"),
        ("forks", "ok", ""),
        ("leaves-a-daemon", "ok", ""),
        ("prints-a-lot", "ok", ""),
    ],
)
def test_it_costs_its_rows_only(method: str, status: str, message: str, run: Path) -> None:
    rows = pd.read_parquet(run / "samples.parquet").set_index("method").loc[[method]]
    assert rows["status"].tolist() == 2 * [status]
    assert all(message in text for text in rows["message"])
    assert np.isfinite(rows["score"]).all()


@pytest.mark.slow
def test_what_it_prints_does_not_fill_the_disk(run: Path) -> None:
    (log,) = (run / "logs").glob("*prints-a-lot.log")
    kept = log.read_bytes()
    assert LOG_HEAD <= len(kept) < LOG_LIMIT
    assert set(kept[:LOG_HEAD]) <= {*b"x\n"}


@pytest.mark.slow
def test_what_it_leaves_behind_is_ended(run: Path) -> None:
    (log,) = (run / "logs").glob("*leaves-a-daemon.log")
    daemon = int(log.read_text().splitlines()[0])
    wait_for(lambda: has_ended(daemon))


# As it is loaded: a process out of the worker's group.
STARTS_SOMETHING = """
import subprocess
from pathlib import Path
process = subprocess.Popen(["sleep", "1000"], start_new_session=True)
Path(__file__).with_suffix(".pid").write_text(str(process.pid))
"""
# And one whose parent has ended, as daemons are made.
STARTS_A_DAEMON = """
import os, time
from pathlib import Path
if (child := os.fork()) == 0:
    os.setsid()
    if (daemon := os.fork()) == 0:
        time.sleep(1000)
    Path(__file__).with_suffix(".pid").write_text(str(daemon))
    os._exit(0)
os.waitpid(child, 0)
"""


@pytest.mark.parametrize("text", [STARTS_SOMETHING, STARTS_A_DAEMON])
def test_a_worker_that_nobody_asks_any_more_ends_what_it_started(text: str, tmp_path: Path) -> None:
    plugin = tmp_path / "starts_something.py"
    plugin.write_text(text)
    process, connection = start_process(serve, (_PluginReader(plugin),), None)
    connection.send(("names",))
    assert connection.poll(60)
    started = int(plugin.with_suffix(".pid").read_text())
    assert psutil.pid_exists(started)
    connection.close()
    assert process.exit_code() == -signal.SIGKILL  # with its group
    wait_for(lambda: has_ended(started))
