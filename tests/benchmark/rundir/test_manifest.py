"""The manifest tells what a reader needs and nothing about who ran it."""

import getpass
import json
import platform
from pathlib import Path

import pytest

from eitbench.benchmark.rundir import manifest
from eitbench.scenarios.errors import DataCorruptError, InputError


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
    ("content", "error"), [(None, InputError), ("{", DataCorruptError), ("[]", DataCorruptError)]
)
def test_a_folder_without_a_good_manifest(
    content: str | None, error: type[Exception], tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / manifest.FILE_NAME).write_text(content)
    with pytest.raises(error, match=manifest.FILE_NAME):
        manifest.read(tmp_path)
