"""A new method's package is complete, passes the checks and overwrites nothing."""

import runpy
import tomllib
from pathlib import Path

import numpy as np
import pytest

from eitbench.benchmark.checks import check_target
from eitbench.commands.scaffold import new_method
from eitbench.methods.problem import Problem
from eitbench.methods.registry import METHOD_REGISTRY
from eitbench.scenarios.data.datasets import load
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.sensors.sensor import foam16


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


def test_a_formula_declares_what_tuning_may_choose(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())
    *_, module, _ = new_method("my-method", tmp_path / "package")
    names = runpy.run_path(str(module), run_name="scaffold")
    search = names["MyMethod"].search
    assert names["MyMethod"]().weight in search["weight"]


def test_a_network_without_weights_says_what_makes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())
    readme, module = new_method("my-net", tmp_path / "package", learned=True)[1:3]
    assert "python eitbench_my_net.py\n" in readme.read_text()
    method = runpy.run_path(str(module), run_name="scaffold")["MyNetMethod"]
    assert method.unusable(foam16()).endswith("train them with `python eitbench_my_net.py`.")


@pytest.mark.slow
def test_a_network_is_trained_stored_and_loaded_with_its_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())
    module = new_method("my-net", tmp_path / "package", learned=True)[2]
    names = runpy.run_path(str(module), run_name="scaffold")
    method = names["MyNetMethod"]()
    train = load("quick", split="train", limit=3)
    problem = Problem(train.sensor, train.references[0], lambda of, n: load("quick", of, n))
    with pytest.raises(InputError, match="'my-net' has no weights"):
        method.fit(problem)
    capsys.readouterr()
    names["train"](n=3, epochs=1, seed=4)
    log = capsys.readouterr().out
    assert log.startswith("Data: 3 training samples of quick, simulated unless they are stored\n")
    assert "epoch 1 of 1: mean squared error " in log
    method.fit(problem)
    assert method.unusable(train.sensor) == ""
    assert method.trained_on == {
        "scenario": "quick", "train_data": train.data_hash, "train_samples": "3", "seed": "4",
    }  # fmt: skip
    assert method.train_s > 0
    images = method.reconstruct(np.stack([train.references[0], train.voltages[0]]))
    assert images.shape == (2, 80, 80)
    assert (images[0] == problem.background).all()
    assert (images[1] != problem.background).any()
    held = load("quick", split="validation")
    assert held.conductivity is not None
    # Validation samples have reference frames of their own, which training uses.
    errors = method.reconstruct(held.voltages) - held.conductivity
    stated = method.uncertainty(held.voltages[:2])
    np.testing.assert_allclose(stated[0], np.sqrt((errors**2).mean(axis=0)), rtol=0.05)
    np.testing.assert_array_equal(stated[1], stated[0])


@pytest.mark.nightly
def test_the_network_keeps_the_contract_once_it_is_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(METHOD_REGISTRY, "_registered", METHOD_REGISTRY.known())
    module = new_method("my-net", tmp_path / "package", learned=True)[2]
    runpy.run_path(str(module), run_name="scaffold")["train"]()
    (report,) = check_target(str(module))
    assert report.passed, report.failed


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
    with pytest.raises(InputError, match=r"The name 'noser' is taken \(method\)"):
        new_method("noser", tmp_path / "package")


def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EitbenchError, match="Could not write"):
        new_method("my-method", tmp_path / "file" / "package")
