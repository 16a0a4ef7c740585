"""A new method's package is complete, passes the checks and overwrites nothing."""

import tomllib
from pathlib import Path

import pytest

from eitbench.benchmark.checks import check_target
from eitbench.commands.scaffold import new_method
from eitbench.scenarios.errors import EitbenchError, InputError


def test_the_package_passes_the_checks(tmp_path: Path) -> None:
    written = new_method("my-method", tmp_path / "package")
    assert {path.name for path in written} == {
        "pyproject.toml",
        "README.md",
        "eitbench_my_method.py",
        "test_eitbench_my_method.py",
    }
    project = tomllib.loads((tmp_path / "package" / "pyproject.toml").read_text())["project"]
    assert project["name"] == "eitbench-my-method"
    points = project["entry-points"]["eitbench.methods"]
    assert points == {"my-method": "eitbench_my_method:MyMethod"}
    module = tmp_path / "package" / "eitbench_my_method.py"
    (report,) = check_target(str(module))
    assert report.name == "my-method"
    assert report.passed, report.failed
    assert not any("$" in path.read_text() for path in written)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(InputError, match="nothing is written"):
        new_method("my-method", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "mine"


@pytest.mark.parametrize("name", ["", "My", "1st", "a_b", "../up", "a--b", "class", "x" * 60, "ü"])
def test_names_that_cannot_be_packages_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot name a new method"):
        new_method(name, tmp_path / "package")
    assert not (tmp_path / "package").exists()


def test_a_taken_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a method 'noser' already"):
        new_method("noser", tmp_path / "package")


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EitbenchError, match="Could not write"):
        new_method("my-method", tmp_path / "file" / "package")
