"""Memory that a worker takes beside its own pages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from eitbench.benchmark.workers.control_group import control_group, make_group
from eitbench.benchmark.workers.memory import SHARED_MEMORY, MemoryMeter
from eitbench.benchmark.workers.messages import WorkerLostError
from eitbench.benchmark.workers.process import start_process
from eitbench.benchmark.workers.worker import Worker, _PluginReader, serve

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs /dev/shm: run on Linux")
# More than a worker takes by itself, and less than that with 256 MiB.
LIMIT_MB = 300
SHARED = """
import os, time
from pathlib import Path

shared = Path("/dev/shm") / f"eitbench-test-{os.getpid()}"
held = shared.open("wb", buffering=0)
Path(__file__).with_suffix(".shared").write_text(str(shared))

def fill():
    for _ in range(256):
        held.write(bytes(2**20))  # not mapped, so no pages of any process
    time.sleep(1000)
"""
TAKES = {
    "open": "fill()",
    "unlinked": "shared.unlink(); fill()",
    "nameless": "held = open(os.memfd_create('held'), 'wb', buffering=0); fill()",
    "by-a-daemon": """
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        fill()
    os._exit(0)
time.sleep(1000)
""",
}


@pytest.mark.parametrize("what", TAKES)
def test_files_in_memory_count(what: str, tmp_path: Path) -> None:
    plugin = tmp_path / f"{what}.py"
    plugin.write_text(SHARED + TAKES[what])
    try:
        with (
            Worker(serve, _PluginReader(plugin), memory_limit_mb=LIMIT_MB) as worker,
            pytest.raises(WorkerLostError) as lost,
        ):
            worker.ask("names", limit=60, what="it")
    finally:
        Path(plugin.with_suffix(".shared").read_text()).unlink(missing_ok=True)
    assert lost.value.failure.message == f"it took more than {LIMIT_MB} MB of memory"


PASSING = """
import os
from pathlib import Path

shared = Path("/dev/shm") / f"eitbench-test-{os.getpid()}"
Path(__file__).with_suffix(".shared").write_text(str(shared))
shared.write_bytes(bytes(2**28))
"""


def test_a_file_that_nobody_saw_open_counts(tmp_path: Path) -> None:
    """Where the worker has a control group."""
    group = make_group(os.getpid())
    if group is None:
        pytest.skip("needs a control group for memory: run as root, or under a delegated group")
    group.rmdir()
    plugin = tmp_path / "passing.py"
    plugin.write_text(PASSING)
    process, connection = start_process(serve, (_PluginReader(plugin),), None)
    try:
        connection.send(("names",))
        connection.recv_bytes()  # the file is written and closed; nobody has looked meanwhile
        used = process.memory_mb()
    finally:
        connection.close()
        process.end()
        Path(plugin.with_suffix(".shared").read_text()).unlink()
    assert used > 256
    groups = control_group(process.pid)
    assert groups is not None
    assert not groups.exists()


HOLDS = """
import mmap, sys
held = open(sys.argv[1], "w+b", buffering=0)
held.write(bytes(2**26))
mapped = mmap.mmap(held.fileno(), 2**26)
print(mapped[:].count(0), flush=True)
input()
mapped.close()
held.close()
print("closed", flush=True)
input()
"""


def test_a_file_in_memory_counts_once_until_it_is_removed() -> None:
    """Mapped or not, open or closed."""
    meter = MemoryMeter(os.getpid())
    before, shared = meter.used_mb(), SHARED_MEMORY / f"eitbench-test-{os.getpid()}"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(shared)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == f"{2**26}\n"
            open_mb = meter.used_mb() - before
            process.stdin.write("\n")
            process.stdin.flush()
            assert process.stdout.readline() == "closed\n"
            closed_mb = meter.used_mb() - before
        finally:
            shared.unlink()
        removed_mb = meter.used_mb() - before
        process.stdin.write("\n")
    assert 64 <= closed_mb <= open_mb + 1 < 128  # its other pages come and go
    assert removed_mb == pytest.approx(closed_mb - 64, abs=8)
