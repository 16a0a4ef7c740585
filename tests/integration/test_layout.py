"""The layout: folders, links and wheel agree, and subpackages import only what lies below them."""

import importlib
import shutil
import subprocess
import sys
import tomllib
import zipfile
from graphlib import TopologicalSorter
from importlib.util import find_spec
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from tests.integration.import_graph import import_graph
from tests.support.source_files import source_files

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = {
    "scenarios": set(),
    "methods": {"scenarios"},
    "benchmark": {"scenarios", "methods"},
    "hardware": {"scenarios", "methods"},
    "reports": {"benchmark"},
}


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    return import_graph()


def test_links_lead_to_the_folders() -> None:
    """Where git makes no links, it writes a file with the target."""
    for name in FOLDERS:
        link = ROOT / "src/eitbench" / name
        target = link.readlink().as_posix() if link.is_symlink() else link.read_text()
        assert target == f"../../{name}"


def test_plugins_of_submissions_are_no_modules_of_ours(tmp_path: Path) -> None:
    """They stay as their authors wrote them: neither lint nor tests look at them."""
    copy = tmp_path / "reports/board/2026.2/submissions/quick/mine/plugins/0a1b.py"
    copy.parent.mkdir(parents=True)
    copy.write_text("import pickle\nimport eitbench.methods, os")
    (tmp_path / "reports/board/records.py").write_text('"""Ours."""\n')
    assert source_files("reports", root=tmp_path) == [tmp_path / "reports/board/records.py"]
    if find_spec("ruff") is None:
        pytest.skip("needs ruff, which `make lint` installs")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for check in (["check"], ["format", "--check"]):
        command = [sys.executable, "-m", "ruff", *check, "."]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


@pytest.mark.slow
def test_a_wheel_holds_every_module_once(tmp_path: Path) -> None:
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    packed = [name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".py")]
    modules = [p.relative_to(ROOT).as_posix() for p in source_files(*FOLDERS)]
    front = ROOT / "src/eitbench"
    modules += [
        p.relative_to(front).as_posix()
        for p in front.rglob("*.py")
        if p.relative_to(front).parts[0] not in FOLDERS
    ]
    assert sorted(packed) == sorted(f"eitbench/{module}" for module in modules)


def test_the_source_distribution_packs_the_same_folders() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    targets = project["tool"]["hatch"]["build"]["targets"]
    beside = ["CHANGELOG.md", "CITATION.cff", "constraints.txt"]
    packed = [*targets["wheel"]["only-include"], "examples", *beside]
    assert targets["sdist"]["only-include"] == packed
    assert all((ROOT / name).exists() for name in packed)


def test_folders_import_only_what_they_may(graph: dict[str, set[str]]) -> None:
    for node, imported in graph.items():
        folder = node.split("/")[0]
        for other in imported:
            assert other.split("/")[0] in FOLDERS[folder] | {folder}, f"{node} imports {other}"


def test_no_subpackages_import_each_other_in_a_cycle(graph: dict[str, set[str]]) -> None:
    assert len(list(TopologicalSorter(graph).static_order())) == len(graph)
    assert "benchmark/run" in graph["benchmark/studies"]  # the graph is not empty by mistake


def test_no_subpackage_has_the_name_of_what_its_folder_offers() -> None:
    """Once it is imported, the folder's attribute of that name would be the subpackage."""
    for name in FOLDERS:
        offered = getattr(importlib.import_module(f"eitbench.{name}"), "__all__", [])
        assert not [of for of in offered if (ROOT / name / of).is_dir()]


def test_no_reader_can_run_what_it_reads() -> None:
    """Files we read are data: no pickle, no eval, no shell."""
    for file in source_files(*FOLDERS):
        text = file.read_text()
        assert "pickle" not in text.replace("allow_pickle=False", ""), file
        assert "shell=True" not in text, file
