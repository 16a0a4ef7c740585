"""The sums of a version: of the files that are there, and of all others as they were."""

import os
from pathlib import Path

import pytest

from eitbench.benchmark.submissions.sums import SUMS, check_sums, is_noted, note_sums
from eitbench.scenarios.errors import DataCorruptError


@pytest.fixture
def version(tmp_path: Path) -> Path:
    for name in ("bench/a", "bench/b", "other/a"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(name)
    note_sums([tmp_path / "bench" / "a", tmp_path / "bench" / "b"])
    note_sums([tmp_path / "other" / "a"])
    return tmp_path


def test_a_record_that_is_written_again_has_its_new_sums_alone(version: Path) -> None:
    record, other = version / "bench", version / "other"
    assert is_noted(record)
    assert is_noted(other)
    known = (record / "a").stat()
    (record / "a").write_text("new")
    os.utime(record / "a", ns=(known.st_atime_ns, known.st_mtime_ns))  # as `cp -p` does
    with pytest.raises(DataCorruptError, match=r"bench/a is not the file that SHA256SUMS notes"):
        is_noted(record)
    (record / "b").rename(record / "c")
    note_sums([record / "a", record / "c"])
    assert is_noted(record)
    assert is_noted(other)


def test_a_file_that_is_gone_stays_noted(version: Path) -> None:
    """Nobody hides it by writing another record."""
    (version / "other" / "a").unlink()
    note_sums([version / "bench" / "a"])
    with pytest.raises(DataCorruptError, match="other/a is gone"):
        is_noted(version / "other")
    names = [line.split()[1] for line in (version / SUMS).read_text().splitlines()]
    assert names == ["bench/b", "other/a", "bench/a"]


def test_a_stray_file_in_a_record_is_named(version: Path) -> None:
    (version / "bench" / "notes.txt").write_text("mine")
    assert is_noted(version / "other")
    for check in (lambda: is_noted(version / "bench"), lambda: check_sums(version)):
        with pytest.raises(DataCorruptError, match=r"bench/notes\.txt is not noted in SHA256SUMS"):
            check()


def test_a_record_that_its_version_has_not_noted_is_refused(version: Path) -> None:
    (version / "mine").mkdir()
    (version / "mine" / "a").write_text("a")
    assert not is_noted(version)  # a folder that is in no version
    for check in (lambda: is_noted(version / "mine"), lambda: check_sums(version)):
        with pytest.raises(DataCorruptError, match="mine/a is not noted"):
            check()


def test_a_blank_line_of_sums_is_no_file(version: Path) -> None:
    with (version / SUMS).open("a") as file:
        file.write("\n")
    check_sums(version)
