"""The front door: help, listings, one sentence for every error, exit codes."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from eitbench import __version__, cli
from eitbench.commands import console, listing

DATA = Path(__file__).parents[1] / "benchmark" / "data"
TINY, OPERATORS = str(DATA / "tiny.toml"), str(DATA / "tiny-operators.toml")
RECORDS = Path(__file__).parents[2] / "reports" / "board"

Run = Callable[..., tuple[int, str, str]]


def commands(group: Any, path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Every command and group of commands, as words."""
    found = [path]
    for name, command in getattr(group, "commands", {}).items():
        found += commands(command, (*path, name))
    return found


@pytest.mark.parametrize("command", commands(get_command(cli.app)))
def test_every_command_has_help_with_an_example(command: tuple[str, ...], eitbench: Run) -> None:
    code, out, _ = eitbench(*command, "--help")
    assert code == 0
    assert f"Example: eitbench {' '.join(command)}" in " ".join(out.split())


def test_help_has_no_words_in_brackets() -> None:
    """The terminal takes "[mm]" for the name of a style, and shows nothing."""
    for words in commands(get_command(cli.app)):
        command: Any = get_command(cli.app)
        for word in words:
            command = command.commands[word]
        texts = [command.help, *(getattr(param, "help", "") for param in command.params)]
        assert not [text for text in texts if re.search(r"\[[a-z]", text or "", re.IGNORECASE)]


def test_version(eitbench: Run) -> None:
    assert eitbench("--version") == (0, f"eitbench {__version__}\n", "")


def test_without_a_command_the_help_is_shown(eitbench: Run) -> None:
    code, out, err = eitbench()
    assert code == 2
    assert "Usage: eitbench" in out + err


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("methods", "noser"),
        ("operators", "fem"),
        ("scenarios", "quick"),
        ("sensors", "foam16"),
        ("suites", "paper"),
        ("recordings", "ohmc16"),
        ("boards", "teensy"),
    ],
)
def test_names_are_listed_and_never_cut(
    what: str, name: str, eitbench: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, out, err = eitbench("list", what, "--json")
    assert (code, err) == (0, "")
    rows = json.loads(out)
    names = {row["name"] for row in rows}
    assert name in names
    if what == "recordings":  # what to cite is for programs: it is longer than a line
        assert all(row["citation"] and row["licence"] and row["source"] for row in rows)
    for width in (40, 80):
        monkeypatch.setattr(console, "width", lambda width=width: width)
        code, out, _ = eitbench("list", what)
        assert code == 0
        assert {line.split(" ")[0] for line in out.splitlines()} >= names
        assert max(map(len, out.splitlines())) <= width
        assert "citation" not in out


BAD_INPUT: list[tuple[tuple[str, ...], str]] = [
    (("run", "qiuck"), "'quick'"),
    (("run", TINY, "--methods", "nosr"), "'noser'"),
    (("run", TINY, "--operators", "fem"), "ranks methods"),
    (("run", OPERATORS, "--operators", "fme"), "'fem'"),
    (("run", OPERATORS, "--methods", "noser"), "ranks operators"),
    (("tune", OPERATORS), "ranks operators"),
    (("run", TINY, "--scenarios", "tinny"), "'tiny'"),
    (("run", "no-such.toml"), "no-such.toml"),
    (("run", TINY, "--plugin", "no-such.py"), "no-such.py"),
    (("run", "--resume", "no-such-run"), "no-such-run"),
    (("check", "nosr"), "'noser'"),
    (("check", "no-such.py"), "no-such.py"),
    (("new-method", "No Good"), "'No Good'"),
    (("recordings", "fetch", "ohmc61"), "'ohmc61'"),
    (("leaderboard", "no-such-run"), "no-such-run"),
    (("emulate", "--protocol", "tensy"), "'teensy'"),
    (("emulate", "--speed", "0"), "speed"),
    (("reproduce", "--runs", "no-such-run"), "no-such-run"),
    (("gate", "no-such-run", "--baseline", "no-such-run"), "no-such-run"),
]
BAD_USAGE: list[tuple[tuple[str, ...], str]] = [
    (("run",), "suite"),
    (("run", TINY, "--limit", "0"), "--limit"),
    (("run", TINY, "--jobs", "none"), "--jobs"),
    (("run", TINY, "--no-such-option"), "--no-such-option"),
    (("run", TINY, "--methods", ","), "--methods"),
    (("run", TINY, "--scenarios", ""), "--scenarios"),
    (("run", "--resume", "somewhere", "--methods", "noser"), "resumed"),
    (("run", "--resume", "somewhere", "--methods", ""), "resumed"),
    (("tune",), "'suite'"),
    (("reproduce", "--runs", "somewhere", "--limit", "5"), "--limit"),
    (("gate", "a", "--baseline", "b", "--margin", "score"), "FIGURE=LOSS"),
    (("gate", "a", "--baseline", "b", "--margin", "score=-1"), "FIGURE=LOSS"),
    (("gate", "a", "--baseline", "b", "--margin", "score=much"), "FIGURE=LOSS"),
    (("gate", "a", "--baseline", "b", "--margin", "S=1", "--margin", "score=2"), "twice"),
    (("list", "nonsense"), "nonsense"),
    (("no-such-command",), "no-such-command"),
]


@pytest.mark.parametrize(("arguments", "says"), [*BAD_INPUT, *BAD_USAGE])
def test_errors_are_one_sentence(arguments: tuple[str, ...], says: str, eitbench: Run) -> None:
    """That on bad usage leads to the help."""
    code, out, err = eitbench(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("eitbench: ")
    assert says in err
    assert err.count("\n") == 1
    assert err.endswith("--help`.\n") == ((arguments, says) in BAD_USAGE)


@pytest.mark.parametrize(
    ("suite", "field", "old", "new"),
    [(TINY, "methods", "noser", "nosr"), (OPERATORS, "operators", "jacobian", "jacobina")],
)
def test_a_suite_that_names_what_is_unknown_is_named_with_its_field(
    suite: str, field: str, old: str, new: str, tmp_path: Path, eitbench: Run
) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(Path(suite).read_text().replace(f'"{old}"', f'"{new}"'))
    for command in ("run", "tune") if field == "methods" else ("run",):
        code, _, err = eitbench(command, str(path))
        assert code == 2
        for part in (str(path), f"'{field}'", f"'{new}'", f"'{old}'"):
            assert part in err
    # What is chosen on the command line is not the file's fault.
    assert str(path) not in eitbench("run", str(path), f"--{field}", "tvv")[2]


@pytest.mark.parametrize(
    "command", [("run", "--resume"), ("report",)], ids=lambda words: " ".join(words)
)
def test_nothing_is_written_into_a_record(
    command: tuple[str, ...], tmp_path: Path, eitbench: Run
) -> None:
    record = tmp_path / "tank"
    shutil.copytree(RECORDS / "2026.2" / "tank", record)
    before = {path.name: path.read_bytes() for path in record.iterdir()}
    code, _, err = eitbench(*command, record)
    assert (code, "is a record or a submission" in " ".join(err.split())) == (2, True)
    assert {path.name: path.read_bytes() for path in record.iterdir()} == before


@pytest.mark.parametrize("lost", ["samples.parquet", "methods.parquet"])
def test_a_record_that_lacks_a_table_is_to_be_taken_again(
    lost: str, tmp_path: Path, eitbench: Run
) -> None:
    record = tmp_path / "tank"
    shutil.copytree(RECORDS / "2026.2" / "tank", record)
    (record / lost).unlink()
    code, _, err = eitbench("leaderboard", record)
    said = " ".join(err.split())
    assert code != 0
    assert f"lacks {lost}" in said
    assert "take the folder again from where it came from" in said


def test_fetch_reports_the_folder_that_holds_the_set(recorded_data: Path, eitbench: Run) -> None:
    folder = recorded_data / "DSHardman" / "HydrogelEIT"
    assert eitbench("recordings", "fetch", "ohmc16") == (0, f"ohmc16 is in {folder}\n", "")


def test_a_traceback_only_with_debug(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["eitbench", "run", "qiuck", "--debug"])
    with pytest.raises(ValueError, match="qiuck"):
        cli.main()


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [(KeyboardInterrupt(), 130, "Interrupted"), (ZeroDivisionError("a bug"), 1, "--debug")],
)
def test_ctrl_c_and_bugs_are_one_sentence(
    error: BaseException, code: int, says: str, monkeypatch: pytest.MonkeyPatch, eitbench: Run
) -> None:
    def fail() -> list[listing.Row]:
        raise error

    monkeypatch.setitem(listing.LISTINGS, "suites", fail)
    found, out, err = eitbench("list", "suites")
    assert (found, out, err.count("\n")) == (code, "", 1)
    assert says in err
    assert str(error) in err


def test_a_reader_that_stops_early_is_no_error() -> None:
    command = [sys.executable, "-m", "eitbench.cli", "list", "recordings", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        program.stdout.close()  # long before it has loaded what it lists
        assert program.stderr.read() == b""
        assert program.wait(60) == 0


def test_a_pipe_is_utf_8_whatever_the_locale() -> None:
    """Windows' own encodings have no arrows, which stand in the heads of tables."""
    record = Path(__file__).parents[2] / "reports" / "board" / "2026.2" / "quick"
    command = [sys.executable, "-m", "eitbench.cli", "leaderboard", str(record)]
    env = {**os.environ, "PYTHONIOENCODING": "cp1252"}
    done = subprocess.run(command, capture_output=True, env=env)
    assert (done.returncode, done.stderr) == (0, b"")
    assert "↑" in done.stdout.decode()
