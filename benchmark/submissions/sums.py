"""Hashes of the files of the leaderboard, which show whether somebody changed one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from eitbench.benchmark.submissions.submission import FOLDER
from eitbench.scenarios.errors import DataCorruptError
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.files import sha256_of

SUMS = "SHA256SUMS"
"""Of all records and hidden figures of a version: shows that nobody changed them, with
`sha256sum -c SHA256SUMS`."""


def sums_of(folder: Path) -> list[str]:
    """Lines of the SHA-256 of the files of a record, or of hidden figures, by name.

    They are as `sha256sum` writes and checks them.
    """
    return [_sum_of(path) for path in sorted(folder.iterdir()) if path.is_file()]


def note_sums(paths: Sequence[Path]) -> None:
    """Add new files of one folder of a version to its sums; those that they replace go."""
    folder = paths[0].parent
    sums, new = folder.parent / SUMS, {path.name for path in paths}

    def is_kept(name: str) -> bool:
        of, _, file = name.partition("/")
        return of != folder.name or (file not in new and (folder / file).is_file())

    noted = sums.read_text().splitlines(keepends=True) if sums.is_file() else []
    kept = [line for line in noted if is_kept(line[66:].strip())]
    atomic_write(sums, "".join([*kept, *map(_sum_of, paths)]).encode())


def check_sums(version: Path) -> None:
    """Check that the records and hidden figures of a version are those that it has noted.

    Raises:
        DataCorruptError: a file has changed, is gone, or was added.
    """
    sums = version / SUMS
    lines = sums.read_text(errors="replace").splitlines(keepends=True) if sums.is_file() else []
    noted = {line[66:].strip(): line for line in lines}
    folders = [path for path in version.iterdir() if path.is_dir() and path.name != FOLDER]
    there = {
        f"{folder.name}/{path.name}": path
        for folder in folders
        for path in folder.iterdir()
        if path.is_file()
    }
    for name in sorted(noted.keys() | there.keys()):
        if name not in there:
            what = "is gone"
        elif name not in noted:
            what = f"is not noted in {SUMS}"
        elif noted[name] != _sum_of(there[name]):
            what = f"is not the file that {SUMS} notes"
        else:
            continue
        raise DataCorruptError(
            f"{version / name} {what}: published records are never edited. Take the version from "
            "git again."
        )


def fit_sums(folder: Path) -> bool:
    """True if the files of a record are those that its version has noted."""
    sums = folder.parent / SUMS
    if not sums.is_file():
        return False
    files = [sums, *sorted(path for path in folder.iterdir() if path.is_file())]
    return _fit(folder, tuple((path.name, path.stat().st_mtime_ns) for path in files))


@lru_cache(maxsize=64)
def _fit(folder: Path, _state: tuple[tuple[str, int], ...]) -> bool:
    """`fit_sums`, kept for as long as no file changes: it is asked for every row of a board."""
    noted = (folder.parent / SUMS).read_text(errors="replace").splitlines(keepends=True)
    return {line for line in noted if line[66:].startswith(f"{folder.name}/")} == {*sums_of(folder)}


def _sum_of(path: Path) -> str:
    return f"{sha256_of(path)}  {path.parent.name}/{path.name}\n"
