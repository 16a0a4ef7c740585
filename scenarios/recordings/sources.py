"""The public sources: repository, commit, licence and checksums, listed in `sources.json`."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any
from urllib.parse import quote

from eitbench.scenarios.errors import InputError


@dataclass(frozen=True)
class RecordedFile:
    """One upstream file: its path inside the repository, its size and its SHA-256."""

    path: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class Source:
    """Files of one public GitHub repository at one commit.

    Attributes:
        repository: `owner/name`.
        commit: 40 hexadecimal digits.
        licence: as stated upstream.
        files: the files that are needed.
    """

    repository: str
    commit: str
    licence: str
    files: tuple[RecordedFile, ...]

    def url(self, file: RecordedFile) -> str:
        """Public address of `file`."""
        return (
            f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{quote(file.path)}"
        )


@cache
def _listing() -> dict[str, Any]:
    text = resources.files("eitbench.scenarios.recordings").joinpath("sources.json").read_text()
    listing: dict[str, Any] = json.loads(text)
    return listing


def source(repository: str, wanted: Callable[[str], bool]) -> Source:
    """The files of `repository` whose path is `wanted`, in order of their paths.

    Raises:
        InputError: no such file is listed.
    """
    entry = _listing()[repository]
    files = tuple(RecordedFile(**f) for f in entry["files"] if wanted(f["path"]))
    if not files:
        raise InputError(f"sources.json lists no such file of {repository}.")
    return Source(repository, entry["commit"], entry["licence"], files)


def source_of(repository: str, *paths: str) -> Source:
    """The named files of `repository`.

    Raises:
        InputError: a path that is not listed.
    """
    found = source(repository, lambda path: path in paths)
    if len(found.files) != len(paths):
        missing = set(paths) - {f.path for f in found.files}
        raise InputError(f"sources.json does not list {sorted(missing)} of {repository}.")
    return found
