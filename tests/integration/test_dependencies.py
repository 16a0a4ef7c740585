"""pyproject.toml declares what is imported, and nothing else."""

import ast
import re
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from tests.support.source_files import source_files

from eitbench.scenarios.extras import EXTRAS

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("scenarios", "methods", "benchmark", "hardware", "reports", "src/eitbench")
OURS = {"eitbench", "tests"}
BY_NAME = {"pytest.importorskip", "files"}  # functions that take the name of a package
# Uvicorn imports the one for the live view, whose tests use it, pandas the other.
USED_BY_OTHERS = {"websockets", "openpyxl"}
# Programs, plugins of pytest, and what the others take.
PROGRAMS = {
    "mlcroissant", "playwright", "pytest-benchmark", "pytest-timeout", "pytest-xdist",
    "scikit-image",
}  # fmt: skip


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def declared(*groups: str) -> set[str]:
    """Names in groups of dependencies, with those of the groups that they name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lists = {"": project["dependencies"], **project["optional-dependencies"]}
    found: set[str] = set()
    for line in (line for group in groups for line in lists[group]):
        if named := re.fullmatch(r"eitbench\[(.*)\]", line):
            found |= declared(*named[1].split(","))
        else:
            found.add(normal(re.split(r"[\[<>=~! ]", line)[0]))
    return found


@cache
def imported(*folders: str) -> set[str]:
    """Names of the packages on the index whose modules the files import."""
    modules = set()
    for file in source_files(*folders):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                modules.add(node.module.split(".")[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func) in BY_NAME:
                named = [part.value for part in node.args[:1] if isinstance(part, ast.Constant)]
                modules |= {str(name).split(".")[0] for name in named}
    known = packages_distributions()  # of what is installed: other imports fail by themselves
    return {normal(known[module][0]) for module in modules & set(known) - OURS}


@pytest.mark.slow
def test_the_package_declares_what_it_imports_and_nothing_else() -> None:
    needed = imported(*FOLDERS)
    assert needed <= declared("", "all", "jax", "peers")
    assert declared("", "all") - needed <= USED_BY_OTHERS


def test_every_library_of_an_extra_is_known_to_messages() -> None:
    """By the names of distributions, but for those that differ from their modules'."""
    modules = {"pyserial": "serial"}
    for extra in ("cluster", "excel", "jax", "learned", "live", "peers", "report", "tune"):
        found = {modules.get(name, name) for name in declared(extra)}
        assert found == {module for module, (_, of) in EXTRAS.items() if of == extra}
    assert not {normal(module) for module in EXTRAS} & declared("")


@pytest.mark.slow
def test_the_tests_declare_what_they_import_and_nothing_else() -> None:
    needed = imported("tests")
    assert needed <= declared("", "test", "docs", "mutation")
    assert declared("test") - needed <= PROGRAMS | USED_BY_OTHERS | imported(*FOLDERS)
