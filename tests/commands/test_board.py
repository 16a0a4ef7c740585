"""The command `eitbench board`: a whole run becomes a record, once."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from eitbench.benchmark.analysis.results import read_run
from eitbench.benchmark.rundir import manifest
from eitbench.cli import app
from eitbench.commands.board import VERSION, _check_remade
from eitbench.scenarios import extras
from eitbench.scenarios.errors import DataUnavailableError, InputError
from eitbench.scenarios.suites import suite as suites
from eitbench.scenarios.suites.scenario import SimulatedScenario
from eitbench.scenarios.suites.suite import Suite

SMALL = SimulatedScenario(
    name="n", image_shape=(20, 20), families=("circle",), train=0, validation=2, test=4
)
SUITE = Suite(name="quick", title="Quick", methods=("noser",), scenarios=(SMALL,))


@pytest.fixture(autouse=True)
def committed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manifest, "git_commit", lambda: "a" * 40)


def board(folder: Path, *arguments: str) -> list[str]:
    return ["board", *arguments, "--runs", str(folder / "runs"), "--records", str(folder / "board")]


@pytest.mark.slow
def test_a_suite_is_run_and_recorded_and_its_cost_is_known_from_then_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suites, "load_suite", lambda name: SUITE)
    result = CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    assert result.exit_code == 0
    assert "The cost of 'quick' is not known" in result.output
    assert (tmp_path / "board" / VERSION / "quick" / "samples.parquet").is_file()
    with pytest.raises(InputError, match="never edited: give a new --version"):
        CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    # The run is finished, so that the next version has it at once.
    again = board(tmp_path, "quick", "--version", "2099.1")
    result = CliRunner().invoke(app, again, catch_exceptions=False)
    assert f"for at most 4 frames each in version {VERSION}" in result.output
    assert (tmp_path / "board" / "2099.1" / "quick" / "manifest.json").is_file()


@pytest.mark.slow
def test_methods_that_are_added_are_run_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suites, "load_suite", lambda name: SUITE)
    first = board(tmp_path / "first", "quick")
    with pytest.raises(InputError, match="leave --methods and --scenarios out"):
        CliRunner().invoke(app, [*first, "--methods", "noser"], catch_exceptions=False)
    CliRunner().invoke(app, first, catch_exceptions=False)
    more = SUITE.model_copy(update={"methods": ("noser", "greit")})
    monkeypatch.setattr(suites, "load_suite", lambda name: more)
    records = str(tmp_path / "first" / "board")
    again = ["board", "quick", "--runs", str(tmp_path / "more"), "--records", records]
    again += ["--version", "2099.1", "--methods", "greit"]
    result = CliRunner().invoke(app, again, catch_exceptions=False)
    assert "Rows of 1 method are those of" in result.output
    assert "kept all figures" not in result.output
    other = [*again[:-1], "noser", "--version", "2099.2"]
    with pytest.raises(InputError, match="holds a run of greit on n: name another folder for --r"):
        CliRunner().invoke(app, other, catch_exceptions=False)
    with pytest.raises(InputError, match="Unknown method of suite 'quick': 'tikhonov'"):
        CliRunner().invoke(
            app, [*again[:-1], "tikhonov", "--version", "2099.2"], catch_exceptions=False
        )
    # A finished run by other code is not the record of this one.
    monkeypatch.setattr(manifest, "git_commit", lambda: "b" * 40)
    with pytest.raises(
        InputError, match=r"holds a run by commit a{40},.* name another folder for --"
    ):
        CliRunner().invoke(app, [*again[:-3], "2099.2", *again[-2:]], catch_exceptions=False)
    assert set(read_run(tmp_path / "more" / "quick").cells["method"]) == {"greit"}
    grown = read_run(tmp_path / "first" / "board" / "2099.1" / "quick")
    assert list(grown.cells["method"]) == ["noser", "greit"]


@pytest.mark.parametrize(
    "version", ["", "../../out", "../2099.1", "2026", "v1", "2026.03", "2026.0"]
)
def test_a_version_is_a_year_and_a_number(tmp_path: Path, version: str) -> None:
    with pytest.raises(InputError, match="A version is a year and a number"):
        CliRunner().invoke(
            app, board(tmp_path, "quick", "--version", version), catch_exceptions=False
        )
    assert list(tmp_path.iterdir()) == []


def test_what_is_in_the_way_is_named_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "board").write_text("a file")
    with pytest.raises(InputError, match="is a file: name a folder for records with --records"):
        CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    (tmp_path / "board").unlink()
    (tmp_path / "runs" / "quick").mkdir(parents=True)
    (tmp_path / "runs" / "quick" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds something that is no run"):
        CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    (tmp_path / "file").write_text("mine")
    to_file = ["board", "quick", "--runs", str(tmp_path / "file"), "--records", str(tmp_path)]
    with pytest.raises(InputError, match="file is a file: name a folder for --runs"):
        CliRunner().invoke(app, to_file, catch_exceptions=False)


@pytest.mark.parametrize("what", ["method", "scenario"])
def test_what_the_suite_does_not_have_is_named_before_any_cost(tmp_path: Path, what: str) -> None:
    result = CliRunner().invoke(app, board(tmp_path, "quick", f"--{what}s", "nope"))
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith(f"Unknown {what} of suite 'quick': 'nope'")
    assert result.output == ""


def test_a_recording_that_cannot_be_had_ends_it_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EITBENCH_DATA", str(tmp_path / "none"))
    with pytest.raises(DataUnavailableError, match="ohmc16"):
        CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_suite_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'quick'"):
        CliRunner().invoke(app, board(tmp_path, "quik"), catch_exceptions=False)


@pytest.mark.parametrize("commit", [None, "a" * 40 + "-dirty"])
def test_code_that_nobody_can_take_makes_no_record(
    commit: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(suites, "load_suite", lambda name: SUITE)
    monkeypatch.setattr(manifest, "git_commit", lambda: commit)
    with pytest.raises(InputError, match="with all changes committed"):
        CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    assert not (tmp_path / "runs").exists()


def test_methods_of_every_packaged_suite_can_belong_to_a_record(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of images, of places and operators."""
    monkeypatch.setattr(manifest, "git_commit", lambda: "a" * 40)
    monkeypatch.setattr(extras, "missing", lambda needs: "")
    for name in suites.suites():
        _check_remade(suites.load_suite(name).names)


def test_a_method_whose_library_is_missing_is_not_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The record would be whole without it, as by weights that do not exist."""
    both = SUITE.model_copy(update={"methods": ("noser", "dnn")})
    monkeypatch.setattr(suites, "load_suite", lambda name: both)
    monkeypatch.setattr(extras, "missing", lambda module: "PyTorch is not installed: ...")
    with pytest.raises(InputError, match="'dnn' belongs to the record, and cannot run here: PyT"):
        CliRunner().invoke(app, board(tmp_path, "quick"), catch_exceptions=False)
    assert not (tmp_path / "runs").exists()
