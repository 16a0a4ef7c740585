"""What Windows and macOS lack: modules of POSIX, and links in a clone."""

import ast
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.support.source_files import source_files

from eitbench.hardware.board import BoardError
from eitbench.hardware.emulation.board_server import BoardServer
from eitbench.hardware.protocols.teensy import Teensy
from eitbench.scenarios.sensors.sensor import foam16

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("scenarios", "methods", "benchmark", "hardware", "reports")
POSIX = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}


def imported_at_once(tree: ast.Module) -> Iterator[str]:
    """Names of the modules that importing a module imports, wherever they stand in it."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module.split(".")[0]
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            waiting += ast.iter_child_nodes(node)


@pytest.mark.slow
def test_every_module_is_imported_without_posix() -> None:
    files = source_files(*FOLDERS, "src/eitbench")
    assert len(files) > 200
    for file in files:
        needed = POSIX & set(imported_at_once(ast.parse(file.read_text(encoding="utf-8"))))
        assert not needed, f"{file} imports {needed}: import it where it is used"


def test_an_emulated_board_says_that_it_needs_a_pseudo_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pty", None)
    with pytest.raises(BoardError, match="pseudo-terminal, which this system has not"):
        BoardServer(Teensy, foam16(), lambda time_s: np.zeros(208), 10.0)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs links to stand for copies")
def test_a_clone_without_links_works(tmp_path: Path) -> None:
    """As of `git -c core.symlinks=false`: a link is a file that holds its target."""
    (tmp_path / "src").mkdir()
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    ignored = shutil.ignore_patterns(*FOLDERS, "__pycache__")
    shutil.copytree(ROOT / "src/eitbench", tmp_path / "src/eitbench", ignore=ignored)
    for name in FOLDERS:
        (tmp_path / "src/eitbench" / name).write_text(f"../../{name}")
        (tmp_path / name).symlink_to(ROOT / name)  # a copy would take long
    modules = ", ".join(f"eitbench.{name}" for name in FOLDERS)
    code = f"import {modules}; print(eitbench.reports.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": str(tmp_path / "src")}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.strip() == str(tmp_path / "reports/__init__.py"), done.stderr
