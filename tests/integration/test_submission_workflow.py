"""The workflow of submissions: one folder of a pull request comes in, and nothing else of it."""

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support.repositories import CAN_RUN, ROOT, add, add_script, git

WORKFLOW = ROOT / ".github" / "workflows" / "submission.yml"
FOLDER = "reports/board/2026.1/submissions/quick/mine"

pytestmark = pytest.mark.skipif(not CAN_RUN, reason="needs git and bash")


@pytest.fixture
def request_of(tmp_path: Path) -> Callable[..., tuple[Path, subprocess.CompletedProcess[str]]]:
    """Make a pull request of what a function changes, and run the step of the workflow."""

    def run(
        change: Callable[[Path], None],
    ) -> tuple[Path, subprocess.CompletedProcess[str]]:
        theirs, ours = tmp_path / "theirs", tmp_path / "ours"
        theirs.mkdir()
        git(theirs, "init", "-b", "main")
        add_script(theirs, "submission")
        add(theirs, "code.py", "ours")
        for version in ("2025.2", "2026.1"):
            add(theirs, f"reports/board/{version}/quick/manifest.json")
        add(theirs, FOLDER.replace("mine", "old") + "/submission.json")
        git(theirs, "add", ".")
        git(theirs, "commit", "-m", "base")
        git(tmp_path, "clone", f"file://{theirs}", str(ours))
        git(theirs, "checkout", "-b", "request")
        change(theirs)
        git(theirs, "add", "--all")
        git(theirs, "commit", "-m", "request")
        git(theirs, "checkout", "main")
        add(theirs, "later.py", "of another request, merged meanwhile")
        git(theirs, "add", ".")
        git(theirs, "commit", "-m", "later")
        git(theirs, "merge", "--no-ff", "-m", "merge", "request")
        git(theirs, "update-ref", "refs/pull/7/merge", "HEAD")
        command = [str(ours / ".ci" / "submission"), "7"]
        return ours, subprocess.run(command, check=False, capture_output=True, text=True)

    return run


def test_the_folder_comes_in_and_nothing_else(
    request_of: Callable[..., tuple[Path, subprocess.CompletedProcess[str]]],
) -> None:
    ours, done = request_of(lambda theirs: add(theirs, f"{FOLDER}/submission.json", "{1}"))
    assert done.stdout.strip() == FOLDER
    assert (ours / FOLDER / "submission.json").read_text() == "{1}"
    assert not (ours / "later.py").exists()


def with_code(theirs: Path) -> None:
    add(theirs, f"{FOLDER}/submission.json")
    add(theirs, "code.py", "theirs")


def with_verdict(theirs: Path) -> None:
    add(theirs, f"{FOLDER}/submission.json")
    add(theirs, "reports/board/2026.1/submissions/quick/reproduced.json")


def two(theirs: Path) -> None:
    add(theirs, f"{FOLDER}/submission.json")
    add(theirs, f"{FOLDER}-2/submission.json")


OLD = FOLDER.replace("mine", "old")


def edited(theirs: Path) -> None:
    add(theirs, f"{OLD}/submission.json", "{2}")


def added_to_another(theirs: Path) -> None:
    add(theirs, f"{OLD}/recordings.json")


def moved(theirs: Path) -> None:
    """The same content under another path: git calls it a rename and names the new path alone."""
    add(theirs, f"{FOLDER}/submission.json", "{1}")
    (theirs / "code.py").rename(theirs / FOLDER / "manifest.json")


def moved_within_the_board(theirs: Path) -> None:
    (theirs / OLD).rename(theirs / FOLDER)


def with_deletion(theirs: Path) -> None:
    add(theirs, f"{FOLDER}/submission.json", "{1}")
    (theirs / "code.py").unlink()


def deleted(theirs: Path) -> None:
    shutil.rmtree(theirs / OLD)


def link(theirs: Path) -> None:
    (theirs / FOLDER).symlink_to("old")


def nothing_said(theirs: Path) -> None:
    add(theirs, f"{FOLDER}/samples.parquet")


def strange(theirs: Path) -> None:
    add(theirs, FOLDER.replace("mine", "$(touch ran)") + "/submission.json")


def in_capitals(theirs: Path) -> None:
    add(theirs, FOLDER.replace("mine", "My_Method") + "/submission.json")


def to_a_version_of_its_own(theirs: Path) -> None:
    """The site would show it as the newest one."""
    add(theirs, FOLDER.replace("2026.1", "2099.1") + "/submission.json")


def to_an_older_version(theirs: Path) -> None:
    add(theirs, FOLDER.replace("2026.1", "2025.2") + "/submission.json")


def without_a_record(theirs: Path) -> None:
    add(theirs, FOLDER.replace("quick", "shapes") + "/submission.json")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            to_a_version_of_its_own,
            "newest version with a record of its suite, reports/board/2026.1",
        ),
        (to_an_older_version, "goes to the newest version"),
        (without_a_record, "No suite shapes has a record on the leaderboard"),
        (with_code, "changes nothing else"),
        (with_verdict, "changes nothing else"),
        (two, "changes nothing else"),
        (strange, "changes nothing else"),
        (in_capitals, "My_Method, may have small letters, digits and hyphens alone"),
        (edited, "changes nothing else"),
        (moved, "changes nothing else"),
        (moved_within_the_board, "changes nothing else"),
        (with_deletion, "changes nothing else"),
        (deleted, "changes nothing else"),
        (added_to_another, "results are never edited"),
        (link, "holds no submission.json"),
        (nothing_said, "holds no submission.json"),
    ],
)
def test_another_request_is_refused(
    request_of: Callable[..., tuple[Path, subprocess.CompletedProcess[str]]],
    change: Callable[[Path], None],
    says: str,
) -> None:
    ours, done = request_of(change)
    assert done.returncode == 1
    assert says in done.stderr
    assert done.stdout == ""
    assert (ours / "code.py").read_text() == "ours"


def test_it_has_no_secrets_and_no_right_to_write() -> None:
    text = WORKFLOW.read_text()
    assert "pull_request_target" not in text
    assert "secrets" not in re.sub("#.*", "", text)
    assert re.findall(r"permissions:\n((?:  .*\n)+)", text) == ["  contents: read\n"]
    assert "base.sha" in text
    # What a stranger writes reaches the shell through the environment alone.
    commands = text.partition("run: |")[2]
    assert "${{" not in commands
