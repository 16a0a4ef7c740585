"""Fixtures of all tests: independent reference data, a cache of their own, the command."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from eitbench import cli

# One thread: the suite runs on small machines, and results must not depend on the thread count.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

pytest_plugins = [f"tests.support.{module}" for module in ("made_runs", "ended_runs", "browser")]

SHARED = Path(__file__).resolve().parents[2] / "shared"


# A shell starts what runs in the background with Ctrl-C ignored, and every child would inherit
# that; some tests press Ctrl-C.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# `nohup` does the same with the end of a terminal.
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """With `-n auto`: two more than there are cores, as many a test waits for something."""
    return (os.cpu_count() or 1) + 2


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No test reads or fills the user's cache; the processes of a test run share one."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EITBENCH_CACHE", str(shared / "cache"))
        yield


@pytest.fixture(scope="session", autouse=True)
def times_of_one_frame() -> Iterator[None]:
    """Runs of tests time one frame of each method, beside two calibration solves."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("WARM_SECONDS", "TAIL_SECONDS"):
            patch.setattr(f"eitbench.benchmark.run.method_cell.{name}", 0.0)
        patch.setattr("eitbench.benchmark.run.timing.SOLVES", 1)
        yield


@pytest.fixture
def recorded_data(monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of real recordings, which EITBENCH_DATA names for the test; skips without one."""
    folder = Path(os.environ.get("EITBENCH_DATA") or SHARED / "recordings")
    if not folder.is_dir():
        pytest.skip("needs the real recordings: set EITBENCH_DATA to the folder that holds them")
    monkeypatch.setenv("EITBENCH_DATA", str(folder))
    return folder


@pytest.fixture(scope="session")
def reference_file() -> Path:
    """Voltages and Jacobian of foam16 computed with EIDORS."""
    folder = Path(os.environ.get("EITBENCH_REFERENCE") or SHARED / "reference")
    path = folder / "foam16_eidors.npz"
    if not path.is_file():
        pytest.skip("needs EIDORS' solution: set EITBENCH_REFERENCE to foam16_eidors.npz's folder")
    return path


@pytest.fixture(scope="session")
def paper_text() -> str:
    """The LaTeX source of the published work, which lies beside the project where it may."""
    paths = list(SHARED.glob("000_*.txt"))
    if not paths:
        pytest.skip("needs the paper's text beside the checkout: ../shared/000_*.txt")
    return paths[0].read_text(encoding="utf-8")


@pytest.fixture
def eitbench(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Run a command in this process: exit code, stdout, stderr."""

    def call(*arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["eitbench", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capsys.readouterr()
        code = end.value.code
        return code if isinstance(code, int) else int(code is not None), out, err

    return call
