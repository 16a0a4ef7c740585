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


def note_sums(paths: Sequence[Path]) -> None:
    """Add new files of one folder of a version to its sums; those that they replace go.

    Lines are as `sha256sum` writes and checks them.
    """
    folder = paths[0].parent
    sums, new = folder.parent / SUMS, {path.name for path in paths}

    def is_kept(name: str) -> bool:
        of, _, file = name.partition("/")
        return of != folder.name or (file not in new and (folder / file).is_file())

    kept = [line for path, line in _noted(folder.parent).items() if is_kept(path)]
    atomic_write(sums, "".join([*kept, *map(_sum_of, paths)]).encode())


def check_sums(version: Path) -> None:
    """Check that the records and hidden figures of a version are those that it has noted.

    Raises:
        DataCorruptError: a file has changed, is gone, or was added.
    """
    noted = {path.partition("/")[0] for path in _noted(version)}
    # A stopped command may have left a folder, whose name begins with a dot.
    folders = [path.name for path in version.iterdir() if path.is_dir()]
    there = {name for name in folders if name != FOLDER and not name.startswith(".")}
    for name in sorted(noted | there):
        _check(version / name)


def is_noted(folder: Path) -> bool:
    """True of a record of a version, which has noted its files.

    Raises:
        DataCorruptError: a file has changed, is gone, or was added.
    """
    sums = folder.parent / SUMS
    if not sums.is_file():
        return False
    files = [sums, *sorted(path for path in folder.iterdir() if path.is_file())]
    return _is_noted(folder, tuple((path.name, *_state_of(path)) for path in files))


def _state_of(path: Path) -> tuple[int, ...]:
    """What changes with a file: the time of its last change alone can be set, or be a tick old."""
    of = path.stat()
    return of.st_size, of.st_mtime_ns, of.st_ctime_ns, of.st_ino


@lru_cache(maxsize=64)
def _is_noted(folder: Path, _state: tuple[tuple[str | int, ...], ...]) -> bool:
    """`is_noted`, kept for as long as no file changes: it is asked for every row of a board."""
    _check(folder)
    return True


def _check(folder: Path) -> None:
    """Check the files of one folder of a version, see `check_sums`."""
    noted = {
        path: line
        for path, line in _noted(folder.parent).items()
        if path.startswith(f"{folder.name}/")
    }
    there = sorted(folder.iterdir()) if folder.is_dir() else []
    files = {f"{folder.name}/{path.name}": path for path in there if path.is_file()}
    for name in sorted(noted.keys() | files.keys()):
        if name not in noted:
            raise DataCorruptError(
                f"{folder.parent / name} is not noted in {SUMS}: published records are never "
                "edited. Take the file away."
            )
        if name not in files or noted[name] != _sum_of(files[name]):
            what = f"is not the file that {SUMS} notes" if name in files else "is gone"
            raise DataCorruptError(
                f"{folder.parent / name} {what}: published records are never edited. Take the "
                "version from git again."
            )


def _noted(version: Path) -> dict[str, str]:
    """Lines of the sums of a version, by the file that each is of; empty where it has none."""
    sums = version / SUMS
    lines = sums.read_text(errors="replace").splitlines(keepends=True) if sums.is_file() else []
    return {line[66:].strip(): line for line in lines if line.strip()}


def _sum_of(path: Path) -> str:
    return f"{sha256_of(path)}  {path.parent.name}/{path.name}\n"
