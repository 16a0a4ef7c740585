"""A base installation: classical methods and metrics, and a sentence where an extra is missing."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from eitbench.scenarios.extras import EXTRAS

# Python runs it at its start, in workers, too.
BLOCK = """
import sys
from importlib.machinery import PathFinder

LACKING = set({lacking})


class Base(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.partition(".")[0] in LACKING:
            return None
        return PathFinder.find_spec(name, path, target)


sys.meta_path[:] = [Base if finder is PathFinder else finder for finder in sys.meta_path]
"""


@pytest.fixture
def base(tmp_path: Path) -> Path:
    (tmp_path / "site").mkdir()
    lack(tmp_path, EXTRAS)
    return tmp_path


def lack(base: Path, libraries: Iterable[str]) -> None:
    text = BLOCK.replace("{lacking}", repr(list(libraries)))
    (base / "site" / "sitecustomize.py").write_text(text)


def eitbench(base: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(base / "site"), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-c", "from eitbench.cli import main; main()", *arguments],
        env=os.environ | {"PYTHONPATH": path}, cwd=base, capture_output=True, text=True,
        timeout=250, check=False,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "library", "extra"),
    [
        (("tune", "quick", "--methods", "noser"), "Optuna", "tune"),
        (("train", "dnn", "--suite", "quick"), "PyTorch", "learned"),
        (("run", "operators", "--limit", "1"), "PyTorch", "learned"),
        (("list", "boards"), "pySerial", "live"),
        (("live", "--board", "emulator", "--method", "noser"), "Uvicorn", "live"),
        (("report", "run"), "MarkupSafe", "report"),
        (("run", "quick", "--scheduler", "tcp://127.0.0.1:8786"), "Dask", "cluster"),
    ],
)
def test_a_command_that_needs_an_extra_says_which(
    base: Path, arguments: tuple[str, ...], library: str, extra: str
) -> None:
    (base / "run").mkdir()
    result = eitbench(base, *arguments)
    assert result.returncode != 0
    (line,) = result.stderr.splitlines()
    assert line.endswith(f"{library} is not installed: pip install 'eitbench[{extra}]'.")


@pytest.mark.slow
def test_classical_methods_are_run_and_the_others_left_out_with_the_reason(base: Path) -> None:
    result = eitbench(
        base, "run", "quick", "--scenarios", "quick", "--methods", "noser,dnn,dip", "--limit", "2",
        "--out", "run",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "PyTorch is not installed: pip install 'eitbench[learned]'." in result.stderr
    assert (base / "run" / "leaderboard.csv").read_text().count("noser") == 1
    assert eitbench(base, "leaderboard", "run").returncode == 0
    lack(base, (module for module, (_, extra) in EXTRAS.items() if extra != "report"))
    report = eitbench(base, "report", "run", "--out", "page")
    assert report.returncode == 0, report.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "what", ["methods", "place-methods", "scenarios", "sensors", "suites", "recordings", "families"]
)
def test_what_there_is_is_listed(base: Path, what: str) -> None:
    result = eitbench(base, "list", what)
    assert result.returncode == 0, result.stderr


def test_an_installed_plugin_and_a_new_one_need_no_extra(base: Path) -> None:
    """Nobody else's name is theirs, which is asked of the operators, too, where PyTorch is."""
    example = Path(__file__).parents[2] / "examples" / "eitbench-landweber"
    shutil.copy(example / "eitbench_landweber.py", base / "site")
    offered = base / "site" / "eitbench_landweber-0.1.0.dist-info"
    offered.mkdir()
    (offered / "METADATA").write_text("Metadata-Version: 2.1\nName: landweber\nVersion: 0.1.0\n")
    entry = "[eitbench.methods]\nlandweber = eitbench_landweber:Landweber\n"
    (offered / "entry_points.txt").write_text(entry)
    result = eitbench(base, "list", "methods")
    assert result.returncode == 0
    assert "landweber" in result.stdout
    assert not result.stderr
    assert eitbench(base, "new-method", "my-method").returncode == 0
    assert "is taken (method)" in eitbench(base, "new-method", "noser").stderr


@pytest.mark.slow
def test_a_classical_method_is_checked(base: Path) -> None:
    assert "0 failed" in eitbench(base, "check", "noser").stdout
