"""Processes end with who started them."""

import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from tests.support.waiting import has_ended, wait_for

TINY = Path(__file__).parents[1] / "benchmark" / "data" / "tiny.toml"
SIMULATES = """
import sys
from pathlib import Path
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.suites.suite import load_suite

if __name__ == "__main__":
    load(load_suite(Path(sys.argv[1])).scenarios[0], split="train", jobs=2)
"""


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
