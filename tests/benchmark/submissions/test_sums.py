"""The sums of a version: of the files that are there, and of all others as they were."""

from pathlib import Path

import pytest

from eitbench.benchmark.submissions.sums import SUMS, fit_sums, note_sums


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
    assert fit_sums(record)
    assert fit_sums(other)
    (record / "a").write_text("new")
    assert not fit_sums(record)
    (record / "b").rename(record / "c")
    note_sums([record / "a", record / "c"])
    assert fit_sums(record)
    assert fit_sums(other)


def test_a_file_that_is_gone_stays_noted(version: Path) -> None:
    """Nobody hides it by writing another record."""
    (version / "other" / "a").unlink()
    note_sums([version / "bench" / "a"])
    assert not fit_sums(version / "other")
    names = [line.split()[1] for line in (version / SUMS).read_text().splitlines()]
    assert names == ["bench/b", "other/a", "bench/a"]
