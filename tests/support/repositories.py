"""Small git repositories, for tests of the scripts of continuous integration."""

import shutil
import subprocess
from pathlib import Path

GIT = shutil.which("git") or ""
CAN_RUN = bool(GIT and shutil.which("bash"))
ROOT = Path(__file__).resolve().parents[2]


def git(folder: Path, *arguments: str) -> None:
    """Run git in a folder, as somebody who signs nothing."""
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run([GIT, *who, "-C", str(folder), *arguments], check=True, capture_output=True)


def add(folder: Path, name: str, text: str = "{}") -> None:
    """Write a file, and the folders that it is in."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def add_script(folder: Path, name: str) -> None:
    """Copy a script of continuous integration into a repository."""
    (folder / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / name, folder / ".ci")
