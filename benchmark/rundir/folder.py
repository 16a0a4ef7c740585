"""What a run directory may hold, checked before any of its files is opened.

A run directory may come from somebody else. So it holds regular files and folders only: a link
would have us read or replace another file of the user, and a pipe would have us wait for ever.
"""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from eitbench.scenarios.errors import DataCorruptError

FILES = (
    "manifest.json",
    "samples.parquet",
    "methods.parquet",
    "operators.parquet",
    "places.parquet",
    "tracks.parquet",
    "reconstructions.h5",
    "voltages.h5",
    "places.h5",
    "recordings.json",
    "leaderboard.json",
    "submission.json",
)
FOLDERS = ("figures", "logs", "parts", "plugins", "report")

MOST_ENTRIES = 100_000
MOST_BYTES_OF_JSON = 2**24  # a manifest takes some 100 kB


def check_folder(run: Path) -> None:
    """Check that nothing in the run directory `run` is a link, a pipe, a socket or a device.

    Raises:
        DataCorruptError: something is, or there is no end of entries.
    """
    try:
        _check_entries(run)
    except OSError as error:
        raise DataCorruptError(f"{run} cannot be looked through: {error.strerror}.") from error


def _check_entries(run: Path) -> None:
    for count, entry in enumerate(_entries(run)):
        kind = entry.stat(follow_symlinks=False).st_mode
        if stat.S_ISLNK(kind):
            raise DataCorruptError(
                f"{entry.path} is a link, which may lead anywhere: a run directory holds files. "
                "Delete it, or put the file in its place."
            )
        if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
            raise DataCorruptError(
                f"{entry.path} is a pipe, a socket or a device: a run directory holds files. "
                "Delete it."
            )
        if count >= MOST_ENTRIES:
            raise DataCorruptError(f"{run} holds more than {MOST_ENTRIES:,} files.")


def _entries(folder: Path) -> Iterator["os.DirEntry[str]"]:
    folders = [str(folder)]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                yield entry
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)


def unknown_entries(run: Path) -> list[str]:
    """Return the names in the run directory that no run writes, sorted.

    A run also writes tables of what it shows beside the leaderboard, which nobody reads again.
    """
    known = {*FILES, *FOLDERS}
    tables = (".csv", ".md")
    return sorted(
        entry.name
        for entry in os.scandir(run)
        if entry.name not in known and not (entry.name.endswith(tables) and entry.is_file())
    )


def read_json_file(path: Path) -> bytes:
    """Read a file of JSON of a run directory.

    Raises:
        OSError: there is none.
        ValueError: it is too large for one.
    """
    if path.stat().st_size > MOST_BYTES_OF_JSON:
        raise ValueError(f"it is larger than {MOST_BYTES_OF_JSON:,} bytes")
    return path.read_bytes()
