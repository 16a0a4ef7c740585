"""The wheel and the source archive, installed into empty environments, do what they promise."""

import os
import signal
import subprocess
import sys
import tarfile
from fnmatch import fnmatch
from pathlib import Path
from zipfile import ZipFile

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

from eitbench.methods.weights.weight_files import LEFT_OUT

ROOT = Path(__file__).resolve().parents[2]
PAGE = "http://127.0.0.1:"


class Installed:
    """An environment with nothing but the package and what it needs."""

    def __init__(self, folder: Path, archive: Path, extras: str) -> None:
        self.folder = folder
        subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
        self.bin = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
        self.environment = {
            name: value for name, value in os.environ.items()
            if name not in {"PYTHONPATH", "VIRTUAL_ENV"} and not name.startswith("EITBENCH")
        } | {"EITBENCH_CACHE": str(folder / "cache")}  # fmt: skip
        constraints = ROOT / "constraints.txt"
        self.run(
            "python", "-m", "pip", "install", "-q", "-c", str(constraints), f"{archive}{extras}"
        )

    def run(self, program: str, *arguments: str) -> str:
        result = subprocess.run(
            [str(self.bin / program), *arguments], cwd=self.folder, env=self.environment,
            capture_output=True, text=True, timeout=1500, check=False,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        return result.stdout + result.stderr


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The wheel, built from the unpacked source archive, and that archive.

    A release names the folder `DIST` of those that it is going to publish.
    """
    if ready := os.environ.get("DIST"):
        folder = Path(ready).resolve()
        (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
        return small_enough(wheel), small_enough(source)
    folder = tmp_path_factory.mktemp("dist")
    (made,) = SdistBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])
    with tarfile.open(made) as packed:
        packed.extractall(folder / "unpacked", filter="data")
    (root,) = (folder / "unpacked").iterdir()
    assert {"LICENSE", "README.md", "pyproject.toml"} <= {path.name for path in root.iterdir()}
    (built,) = WheelBuilder(str(root)).build(directory=str(folder), versions=["standard"])
    return small_enough(Path(built)), small_enough(Path(made))


def small_enough(archive: Path) -> Path:
    """The archive, without what stays out of wheels; indices take no larger file unasked."""
    assert archive.stat().st_size < 100e6
    if archive.suffix == ".whl":
        assert not any(fnmatch(name, f"*/{LEFT_OUT}") for name in ZipFile(archive).namelist())
    return archive


@pytest.mark.nightly
def test_a_wheel_with_all_extras_runs_reports_trains_and_shows_a_live_view(
    archives: tuple[Path, Path], tmp_path: Path
) -> None:
    of = Installed(tmp_path, archives[0], "[all]")
    quick = ("--scenarios", "quick", "--limit", "2", "--out", "run")
    of.run("eitbench", "run", "quick", "--methods", "noser,dnn", *quick)
    of.run("eitbench", "report", "run", "--out", "page")
    assert (tmp_path / "page").is_dir()
    few = ("--epochs", "1", "--limit", "128", "--install", "never")
    assert "epoch" in of.run("eitbench", "train", "dnn", "--suite", "quick", *few).lower()
    live = subprocess.Popen(
        [str(of.bin / "eitbench"), "live", "--board", "emulator", "--http-port", "0",
         "--no-browser"],
        cwd=tmp_path, env=of.environment | {"PYTHONUNBUFFERED": "1"}, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    assert live.stdout is not None
    assert any(PAGE in line for line in live.stdout)
    live.send_signal(signal.SIGTERM)
    live.wait(60)


@pytest.mark.nightly
def test_the_source_archive_alone_runs_classical_methods(
    archives: tuple[Path, Path], tmp_path: Path
) -> None:
    of = Installed(tmp_path, archives[1], "")
    out = of.run(
        "eitbench", "run", "quick", "--methods", "noser,dnn", "--scenarios", "quick", "--limit",
        "2", "--out", "run",
    )  # fmt: skip
    assert "pip install 'eitbench[learned]'" in out
    listed = of.run("python", "-m", "pip", "list")
    assert "torch" not in listed
