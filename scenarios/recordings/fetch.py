"""Reading recorded sets: their files are found, or downloaded from the public source, and verified.

Files are looked for in the folder named by the environment variable `EITBENCH_DATA`, laid out as
`<owner>/<repository>/<path>`, then in the user's cache of the same layout, then downloaded to it.
"""

import hashlib
import logging
import os
import threading
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eitbench.scenarios.cache_dir import cache_dir
from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError
from eitbench.scenarios.guard import is_closed
from eitbench.scenarios.recordings import RecordedFrames, RecordedSet, recorded_set
from eitbench.scenarios.recordings.sources import RecordedFile

_CHUNK = 1 << 14
_SILENCE_S = 30.0  # a server that says nothing for so long is given up


def read_recording(
    name: str, *, limit_s: float | None = None, progress: bool = False
) -> RecordedFrames:
    """The frames of the set called `name`: found or downloaded, verified, read and checked.

    Where the test split is closed (see `guard`), those of its frames are left out.

    Args:
        name: of the set.
        limit_s: how long a download may take in all [s]; None for as long as it needs.
        progress: show a progress bar while downloading.

    Raises:
        InputError: unknown name.
        DataUnavailableError: not on this machine and not to be had from the network.
        DataCorruptError: a file differs from what was published.
    """
    recorded = recorded_set(name)
    folder = locate(recorded, limit_s=limit_s, progress=progress)
    verify(recorded, folder)
    recording = recorded.read(folder)
    return recording.without_test() if is_closed() else recording


def inside(folder: Path, path: str) -> Path:
    """The file at `path` in `folder`.

    Raises:
        DataCorruptError: the path leads out of the folder.
    """
    target = folder / path
    if not target.resolve().is_relative_to(folder.resolve()):
        raise DataCorruptError(f"The path {path!r} leads out of {folder}: remove it or the link.")
    return target


def is_intact(target: Path, file: RecordedFile) -> bool:
    """Whether `target` holds the very bytes that were published."""
    if not target.is_file() or target.stat().st_size != file.bytes:
        return False
    with target.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest() == file.sha256


def verify(recorded: RecordedSet, folder: Path) -> None:
    """Refuse altered files.

    Raises:
        DataCorruptError: a file in `folder` differs from what was published; it is named.
    """
    if recorded.own is not None:
        return  # its own checksums were compared when it was described
    for file in recorded.files:
        target = inside(folder, file.path)
        if not is_intact(target, file):
            raise DataCorruptError(
                f"{target} is not the file that was published (its SHA-256 differs): delete it "
                f"and run `eitbench recordings fetch {recorded.name}`."
            )


def cached_folder(recorded: RecordedSet) -> Path:
    """Where the set's files lie in the user's cache."""
    return cache_dir() / "recordings" / recorded.repository


def find(recorded: RecordedSet) -> Path | None:
    """The folder that holds all files of the set, unverified; None if there is none yet."""
    if recorded.own is not None:
        return recorded.own.parent
    given = os.environ.get("EITBENCH_DATA")
    folders = [Path(given).expanduser() / recorded.repository] if given else []
    for folder in (*folders, cached_folder(recorded)):
        if all(inside(folder, file.path).is_file() for file in recorded.files):
            return folder
    return None


def locate(recorded: RecordedSet, *, limit_s: float | None = None, progress: bool = False) -> Path:
    """The folder that holds all files of the set, downloaded if need be.

    Raises:
        DataUnavailableError: not on this machine and not to be had from the network.
    """
    return find(recorded) or fetch(recorded, limit_s=limit_s, progress=progress)


def fetch(recorded: RecordedSet, *, limit_s: float | None = None, progress: bool = False) -> Path:
    """Download what is missing or altered in the user's cache, and return its folder.

    Each file appears under its name only when complete and verified, so that an interrupted
    download or several processes at once leave no broken file.

    Args:
        recorded: the set.
        limit_s: how long all of it may take [s]; a connection that hangs is then abandoned.
        progress: show a progress bar.

    Raises:
        DataUnavailableError: no network, a server's refusal, a full disk, or too slow.
        DataCorruptError: the source offers other bytes than were published.
    """
    folder = cached_folder(recorded)
    missing = [f for f in recorded.files if not is_intact(inside(folder, f.path), f)]
    if not missing:
        return folder
    download = _Download(recorded, folder, missing, progress)
    # Looking up a host can hang beyond every time-out, so a thread is waited for, or left behind.
    worker = threading.Thread(target=download.run, name=f"fetch {recorded.name}", daemon=True)
    worker.start()
    try:
        worker.join(limit_s)
    finally:
        download.abandoned.set()
    if worker.is_alive():
        raise _unavailable(recorded, f"the download took longer than {limit_s:g} s")
    if isinstance(download.failure, DataCorruptError):
        raise download.failure
    if download.failure is not None:
        raise _unavailable(recorded, _reason(download.failure)) from download.failure
    return folder


def intact(recorded: RecordedSet, *, progress: bool = False) -> Path:
    """The folder that holds all files of the set, verified; downloaded or repaired if need be.

    Only the cache is repaired: a folder that `EITBENCH_DATA` names belongs to the user.

    Raises:
        DataUnavailableError: not on this machine and not to be had from the network.
        DataCorruptError: a file differs from what was published.
    """
    folder = find(recorded)
    if folder is None or folder == cached_folder(recorded):
        return fetch(recorded, progress=progress)
    verify(recorded, folder)
    return folder


def _unavailable(recorded: RecordedSet, reason: str) -> DataUnavailableError:
    return DataUnavailableError(
        f"The recorded set {recorded.name!r} is not on this machine and {reason}: run `eitbench "
        f"recordings fetch {recorded.name}` with a network, or set EITBENCH_DATA to a folder "
        f"that holds {recorded.repository}."
    )


def _reason(failure: Exception) -> str:
    status = getattr(getattr(failure, "response", None), "status_code", None)
    if status is not None:
        return f"its source answered with HTTP status {status}"
    # The network's own errors are OSErrors too; those carry a request.
    if isinstance(failure, OSError) and failure.strerror and not hasattr(failure, "request"):
        return f"could not be stored in {cache_dir()} ({failure.strerror})"
    return "could not be downloaded"


class _AbandonedError(Exception):
    """Nobody waits for the download any more."""


class _TooLongError(Exception):
    """More bytes arrive than were published."""


@dataclass
class _Download:
    """The download of `files` to `folder`, run in its own thread."""

    recorded: RecordedSet
    folder: Path
    files: list[RecordedFile]
    progress: bool
    abandoned: threading.Event = field(default_factory=threading.Event)
    failure: Exception | None = None

    def run(self) -> None:
        """Fetch every file; what goes wrong is kept as `failure`."""
        try:
            with self._bar() as bar:
                for file in self.files:
                    self._fetch(file, bar)
        except Exception as error:
            self.failure = error

    def _bar(self) -> Any:
        if not self.progress:
            return nullcontext()
        from rich.console import Console
        from rich.progress import Progress

        console = Console(stderr=True)
        # Without a terminal a bar would leave but an empty line.
        bar = Progress(console=console, transient=True, disable=not console.is_terminal)
        bar.add_task(self.recorded.name, total=sum(file.bytes for file in self.files))
        return bar

    def _fetch(self, file: RecordedFile, bar: Any) -> None:
        import pooch

        target = inside(self.folder, file.path)
        target.parent.mkdir(parents=True, exist_ok=True)
        pooch.get_logger().setLevel(logging.WARNING)
        meter = _Meter(self.abandoned, bar, file.bytes)
        downloader = pooch.HTTPDownloader(
            progressbar=meter, chunk_size=_CHUNK, timeout=(_SILENCE_S, _SILENCE_S)
        )
        other = (
            f"The source offers another {file.path} of {self.recorded.repository} than was "
            "published ({}): it is not used; try again or report it."
        )
        try:
            pooch.retrieve(
                self.recorded.source.url(file),
                known_hash=f"sha256:{file.sha256}",
                fname=target.name,
                path=target.parent,
                downloader=downloader,
            )
        except ValueError as error:
            # requests raises some of its own errors as ValueError too; those carry a request.
            if hasattr(error, "request"):
                raise
            raise DataCorruptError(other.format("its SHA-256 differs")) from error
        except _TooLongError as error:
            raise DataCorruptError(other.format("it is longer")) from error


class _Meter:
    """Pooch's progress-bar protocol: moves the bar, and stops a download nobody waits for.

    It also stops one of more than `most` bytes, which is not what was published.
    """

    def __init__(self, abandoned: threading.Event, bar: Any, most: int) -> None:
        self.abandoned, self.bar, self.most = abandoned, bar, most
        self.arrived = 0
        self.total = 0
        self.shown = 0

    def update(self, n: int) -> None:
        """`n` more bytes have arrived."""
        if self.abandoned.is_set():
            raise _AbandonedError
        # Pooch counts the last chunk as a whole one.
        self.arrived += n
        if self.arrived > self.most + _CHUNK:
            raise _TooLongError
        n = min(n, self.total - self.shown) if self.total else 0
        self.shown += n
        if self.bar is not None:
            self.bar.advance(self.bar.task_ids[0], n)

    def reset(self) -> None:
        """Pooch resets before it fills the bar; what is shown is already right."""
        self.arrived = 0

    def close(self) -> None:
        """Nothing is held open."""
