"""What a release holds of the leaderboard stays as it is; the script that says so."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support.repositories import CAN_RUN, add, add_script, git

pytestmark = pytest.mark.skipif(not CAN_RUN, reason="needs git and bash")

VERSION = "reports/board/2026.1"
RECORD, SUMS, HIDDEN = (
    f"{VERSION}/{name}" for name in ("quick/samples.parquet", "SHA256SUMS", "hidden/quick-1.json")
)
NOTED, OF_AUTHOR = (
    f"{VERSION}/submissions/quick/{name}" for name in ("reproduced.json", "mine/reproduced.json")
)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A repository with a record."""
    git(tmp_path, "init", "-b", "main")
    add_script(tmp_path, "records")
    (tmp_path / RECORD).parent.mkdir(parents=True)
    (tmp_path / RECORD).write_bytes(b"PAR1\x00\xff")
    add(tmp_path, SUMS, "1  quick/samples.parquet\n")
    add(tmp_path, NOTED, '{"1": "32 of 36 samples"}')
    add(tmp_path, OF_AUTHOR, "{}")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-m", "record")
    return tmp_path


def checked(repository: Path) -> subprocess.CompletedProcess[str]:
    git(repository, "add", "--all")
    git(repository, "commit", "--allow-empty", "-m", "later")
    script = [str(repository / ".ci" / "records")]
    return subprocess.run(script, check=False, capture_output=True, text=True)


def test_before_a_release_records_may_change(repository: Path) -> None:
    (repository / RECORD).write_bytes(b"PAR1\x00\xfe")
    done = checked(repository)
    assert (done.returncode, "no record is published yet" in done.stdout) == (0, True)


def test_a_release_may_get_new_files_and_versions(repository: Path) -> None:
    git(repository, "tag", "v0.2.0")
    add(repository, HIDDEN)
    add(repository, SUMS, "1  quick/samples.parquet\n2  hidden/quick-1.json\n")
    add(repository, RECORD.replace("2026.1", "2026.2"))
    add(repository, "reports/board/hidden.toml", "no part of a version")
    add(repository, NOTED, '{"1": "32 of 36 samples", "2": "36 of 36 samples"}')
    done = checked(repository)
    assert (done.returncode, "v0.2.0" in done.stdout, done.stderr) == (0, True, "")


def removed(repository: Path) -> None:
    (repository / RECORD).unlink()


def moved(repository: Path) -> None:
    (repository / RECORD).rename(repository / f"{VERSION}/samples.parquet")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda folder: (folder / RECORD).write_bytes(b"PAR1\x00\xfe"), RECORD),
        (removed, RECORD),
        (moved, RECORD),
        (lambda folder: add(folder, SUMS, "3  quick/samples.parquet\n"), SUMS),
        (lambda folder: add(folder, OF_AUTHOR, '{"1": "all"}'), OF_AUTHOR),
    ],
    ids=["edited", "removed", "moved", "another hash", "in a submission"],
)
def test_a_published_file_that_changed_is_named(
    repository: Path, change: Callable[[Path], object], named: str
) -> None:
    git(repository, "tag", "v0.2.0")
    change(repository)
    done = checked(repository)
    assert done.returncode == 1
    assert named in done.stderr.splitlines()


def test_hashes_of_keys_stay_and_a_key_may_be_retired(repository: Path) -> None:
    keys = "reports/board/hidden.toml"
    add(repository, keys, 'sha256 = "1"\nsha256 = "2"\n')
    git(repository, "add", ".")
    git(repository, "commit", "-m", "keys")
    git(repository, "tag", "v0.2.0")
    add(repository, keys, 'sha256 = "1"\nretired = "k"\nsha256 = "2"\nsha256 = "3"\n')
    assert checked(repository).returncode == 0
    for text in ('sha256 = "1"\n', 'sha256 = "1"\nsha256 = "7"\n'):
        add(repository, keys, text)
        done = checked(repository)
        assert (done.returncode, "are never changed" in done.stderr) == (1, True)
    (repository / keys).unlink()
    assert checked(repository).returncode == 1


def test_a_release_is_compared_with_the_one_before(repository: Path) -> None:
    """The commit that is tagged changes nothing that the last release holds."""
    git(repository, "tag", "v0.2.0")
    (repository / RECORD).write_bytes(b"PAR1\x00\xfe")
    git(repository, "commit", "-am", "edited")
    git(repository, "tag", "v0.2.1")
    script = [str(repository / ".ci" / "records")]
    done = subprocess.run(script, check=False, capture_output=True, text=True)
    assert (done.returncode, "release v0.2.0" in done.stderr) == (1, True)


def test_tags_that_are_no_releases_do_not_count(repository: Path) -> None:
    git(repository, "tag", "before-the-release")
    (repository / RECORD).write_bytes(b"PAR1\x00\xfe")
    git(repository, "commit", "-am", "the record of the release")
    git(repository, "tag", "v0.2.0")
    assert checked(repository).returncode == 0
