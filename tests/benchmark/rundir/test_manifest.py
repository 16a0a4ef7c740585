"""The manifest tells what a reader needs and nothing about who ran it."""

import getpass
import json
import platform
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from eitbench.benchmark.rundir import manifest
from eitbench.scenarios.errors import DataCorruptError, InputError

BARE = platform.processor() or platform.machine()


def test_environment_names_versions_and_machine_but_no_host_and_no_user() -> None:
    found = manifest.environment()
    assert found["versions"]["python"] == platform.python_version()
    assert found["versions"]["eitbench"]
    assert found["versions"]["numpy"]
    machine = found["machine"]
    assert set(machine) == {"cpu", "cores", "memory_mb", "os"}
    assert machine["cores"] >= 1
    assert machine["memory_mb"] > 100
    assert not {platform.node(), getpass.getuser()} & {str(value) for value in machine.values()}
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("\n\nmodel name\t: X\ncpu family\t: 25\nmodel\t\t: 1\n\nmodel name\t: Y\nmodel\t: 2\n",
         "X (family 25, model 1)"),
        ("model name: X\ncpu family: 6\nmodel\t: \n", "X (family 6)"),
        ("processor : 0\n\nmodel name : ARMv7\n", "ARMv7"),
        ("CPU implementer\t: 0x41\nCPU part\t: 0xd0c\n", f"{BARE} (maker 0x41, part 0xd0c)"),
        ("", BARE),
    ],
)  # fmt: skip
def test_a_processor_is_named_with_what_tells_it_from_others(
    text: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(manifest, "CPUINFO", tmp_path / "cpuinfo")
    assert manifest.cpu_model.__wrapped__() == BARE
    manifest.CPUINFO.write_text(text)
    assert manifest.cpu_model.__wrapped__() == expected


def test_the_command_can_be_given_again(monkeypatch: pytest.MonkeyPatch) -> None:
    given = ["run", "my suite.toml", "--parameters", '{"noser": {"weight": 0.1}}']
    monkeypatch.setattr(sys, "argv", ["/usr/bin/eitbench", *given])
    assert shlex.split(manifest.command_line()) == ["eitbench", *given]


def test_the_commit_is_that_of_the_checkout() -> None:
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        pytest.skip("needs a git checkout")
    command = ["git", "-C", str(root), "rev-parse", "HEAD"]
    head = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert str(manifest.git_commit()).removesuffix("-dirty") == head


@pytest.mark.parametrize(
    ("content", "error"), [(None, InputError), ("{", DataCorruptError), ("[]", DataCorruptError)]
)
def test_a_folder_without_a_good_manifest(
    content: str | None, error: type[Exception], tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / manifest.FILE_NAME).write_text(content)
    with pytest.raises(error, match=manifest.FILE_NAME):
        manifest.read(tmp_path)
