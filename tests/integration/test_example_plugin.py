"""The example package, installed beside an installed eitbench, is a method like any other.

Both are built and installed as strangers would install them, into a new environment. What they
depend on is borrowed from the environment that the tests run in, which spares gigabytes; its files
are seen, but not what is installed there in editable form, such as its own eitbench. Continuous
integration does it again with nothing borrowed.
"""

import json
import os
import subprocess
import sysconfig
import venv
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "eitbench-landweber"

hatchling = pytest.importorskip(
    "hatchling", reason="building a package needs hatchling (extra `test`)"
)

Run = Callable[..., str]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run a command of the new environment in a folder far from the sources; its output."""
    folder = tmp_path_factory.mktemp("fresh")
    home = folder / "environment"
    venv.create(home, with_pip=False, symlinks=True)
    programs = home / ("Scripts" if os.name == "nt" else "bin")
    paths = sysconfig.get_paths(vars={"base": str(home), "platbase": str(home)})
    borrowed = {sysconfig.get_paths()[name] for name in ("purelib", "platlib")}
    borrowed.add(str(Path(hatchling.__file__).parents[1]))
    Path(paths["purelib"], "borrowed.pth").write_text("\n".join(sorted(borrowed)))
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")}

    def call(program: str, *options: str | Path) -> str:
        command = [programs / program, *options]
        done = subprocess.run(command, cwd=folder, env=kept, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    options = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check"]
    call("python", "-m", "pip", "install", *options, ROOT, EXAMPLE)
    return call


@pytest.mark.nightly  # continuous integration does it after every change, with nothing borrowed
def test_the_example_is_listed_checked_and_ranked(run: Run, tmp_path: Path) -> None:
    code = "import eitbench.methods as m, eitbench_landweber as n; print(m.__file__, n.__file__)"
    assert str(ROOT) not in run("python", "-c", code)
    rows = {row["name"]: row for row in json.loads(run("eitbench", "list", "methods", "--json"))}
    assert rows["landweber"]["source"].startswith("Landweber")
    assert "0 failed" in run("eitbench", "check", "landweber")
    chosen = ("--methods", "landweber,noser", "--scenarios", "quick", "--limit", "6")
    run("eitbench", "run", "quick", *chosen, "--out", tmp_path / "run")
    board = json.loads((tmp_path / "run" / "leaderboard.json").read_text())
    assert {row["method"]: row["coverage"] for row in board} == {"landweber": 1.0, "noser": 1.0}
    assert sorted(row["rank"] for row in board) == [1, 2]
    score = {row["method"]: row["score"] for row in board}
    assert score["landweber"] > score["noser"] - 1
