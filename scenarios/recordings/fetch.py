"""Recorded sets on this machine: found, or downloaded from their public source, and verified.

Files are looked for in the folder named by the environment variable `EITBENCH_DATA`, laid out as
`<owner>/<repository>/<path>`, then in the user's cache of the same layout, then downloaded to it.
"""

import logging
import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, DataUnavailableError, InputError
from eitbench.scenarios.guard import is_closed
from eitbench.scenarios.recordings.descriptors import RecordedFile, RecordedFrames, RecordedSet
from eitbench.scenarios.recordings.files.own import is_recording, undamaged, untouched_rows
from eitbench.scenarios.recordings.registry import recorded_set
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.storage.cache_dir import cache_dir
from eitbench.scenarios.storage.files import sha256_of

_CHUNK = 1 << 14
_SILENCE_S = 30.0  # a server that sends nothing for so long is given up
SPARE_S = 60.0
"""Time of a download beside that of its bytes [s]."""
LEAST_RATE = 20e3
"""Rate below which a download is given up [bytes/s]."""


def read_recording(name: str, *, progress: bool = False) -> RecordedFrames:
    """Fetch, verify, read and check the frames of the set called `name`.

    Where the test split is closed (see `guard`), its frames are left out.

    Raises:
        InputError: unknown name.
        DataUnavailableError, DataCorruptError: as for `fetch_recording`.
    """
    recorded = recorded_set(name)
    recording = recorded.read(fetch_recording(recorded, progress=progress))
    if recorded.validation is not None:
        folder = fetch_recording(recorded.validation, progress=progress)
        recording = recording.after(recorded.validation.read(folder))
    return recording.without_test() if is_closed() else recording


def fetch_recording(
    recorded: RecordedSet, *, limit_s: float | None = None, progress: bool = False
) -> Path:
    """Return the folder that holds all files of the set, verified by their SHA-256.

    What is missing or altered in the user's cache is downloaded. Each file appears there under its
    name only when it is complete and verified, so that an interrupted download or several processes
    at once leave no broken file. A folder that `EITBENCH_DATA` names belongs to the user, and is
    not repaired.

    Args:
        recorded: the set.
        limit_s: how long a download may take in all [s]; by default as long as a slow network
            takes.
        progress: show a progress bar while downloading.

    Raises:
        DataUnavailableError: no network, a server's refusal, a full disk, or too slow.
        DataCorruptError: a file differs from the published one, here or at the source.
    """
    if recorded.validation is not None:
        fetch_recording(recorded.validation, limit_s=limit_s, progress=progress)
    if recorded.own is not None:
        return recorded.own.parent  # its own checksums were compared when it was described
    if given := os.environ.get("EITBENCH_DATA"):
        folder = Path(given).expanduser() / recorded.repository
        if all(_inside(folder, file).is_file() for file in recorded.files):
            for file in altered(recorded, folder):
                raise DataCorruptError(
                    f"{folder / file.path} is not the file that was published (its SHA-256 "
                    f"differs): delete it and run `eitbench recordings fetch {recorded.name}`."
                )
            return folder
    folder = cached_folder(recorded)
    if files := altered(recorded, folder):
        slow_s = SPARE_S + sum(file.bytes for file in files) / LEAST_RATE
        _download(recorded, folder, files, slow_s if limit_s is None else limit_s, progress)
    return folder


def cached_folder(recorded: RecordedSet) -> Path:
    """The folder of the set's files in the user's cache."""
    return cache_dir() / "recordings" / recorded.repository


def altered(recorded: RecordedSet, folder: Path) -> list[RecordedFile]:
    """The files of the set that are missing in `folder` or differ from the published ones.

    Raises:
        DataCorruptError: a path that leads out of the folder.
    """
    return [
        file
        for file in recorded.files
        if not (path := _inside(folder, file)).is_file() or sha256_of(path) != file.sha256
    ]


def _inside(folder: Path, file: RecordedFile) -> Path:
    target = folder / file.path
    if not target.resolve().is_relative_to(folder.resolve()):
        raise DataCorruptError(f"{target} leads out of {folder}: remove it or the link.")
    return target


def _download(
    recorded: RecordedSet,
    folder: Path,
    files: list[RecordedFile],
    limit_s: float,
    progress: bool,
) -> None:
    import pooch
    from rich.console import Console
    from rich.progress import Progress

    pooch.get_logger().setLevel(logging.WARNING)
    console = Console(stderr=True)
    abandoned = threading.Event()
    failures: list[Exception] = []

    def run() -> None:
        try:
            registry = pooch.create(
                path=folder,
                base_url="",
                registry={file.path: file.sha256 for file in files},
                urls={file.path: recorded.source.url(file) for file in files},
            )
            # Without a terminal a bar would leave but an empty line.
            hidden = not (progress and console.is_terminal)
            with Progress(console=console, transient=True, disable=hidden) as bar:
                for file in files:
                    # Pooch fails where another process makes the same folder at the same time.
                    (folder / file.path).parent.mkdir(parents=True, exist_ok=True)
                    meter = _Meter(file, abandoned, bar, bar.add_task(file.path, total=file.bytes))
                    http = pooch.HTTPDownloader(meter, _CHUNK, timeout=_SILENCE_S)
                    registry.fetch(file.path, downloader=http)
        except Exception as error:
            failures.append(error)

    # Looking up a host can hang beyond every time-out, so a thread is waited for, or left behind.
    worker = threading.Thread(target=run, name=f"fetch {recorded.name}", daemon=True)
    worker.start()
    try:
        worker.join(limit_s)
    finally:
        abandoned.set()
    error = failures[0] if failures else None
    if error is None and not worker.is_alive():
        return
    # Some errors of requests are ValueErrors or OSErrors, too; they hold their request.
    network = hasattr(error, "request")
    if isinstance(error, ValueError) and not network:
        raise DataCorruptError(
            f"The source of {recorded.name!r} offers another file than was published: {error} "
            "It is not used; try again or report it."
        ) from error
    status = getattr(getattr(error, "response", None), "status_code", None)
    reason = "could not be downloaded" + (f" (HTTP status {status})" if status else "")
    if error is None:
        reason = f"the download took longer than {limit_s:g} s"
    elif isinstance(error, OSError) and not network:
        reason = f"could not be stored in {cache_dir()} ({error.strerror})"
    raise DataUnavailableError(
        f"The recorded set {recorded.name!r} is not on this machine and {reason}: run `eitbench "
        f"recordings fetch {recorded.name}` with a network, or set EITBENCH_DATA to a folder that "
        f"holds {recorded.repository}."
    ) from error


@dataclass
class _Meter:
    """Pooch's protocol of a progress bar; it also ends a download that is too long or abandoned."""

    file: RecordedFile
    abandoned: threading.Event
    bar: Any  # of rich
    task: int
    total: int = 0
    arrived: int = 0

    def update(self, n: int) -> None:
        if self.abandoned.is_set():
            raise TimeoutError
        self.arrived += n
        # Pooch counts the last chunk as a whole one.
        if self.arrived > self.file.bytes + _CHUNK:
            raise ValueError(f"{self.file.path} is longer.")
        self.bar.update(self.task, completed=self.arrived)

    def reset(self) -> None:
        self.arrived = 0  # at its end pooch counts the whole file once more

    def close(self) -> None:
        pass


def no_untouched_frame(name: object) -> InputError:
    """The error where frames of the untouched sensor are needed, and there are differences only."""
    return InputError(
        f"{name} holds differences only, so that no frame shows the untouched sensor."
    )


def reference_frames(name: str) -> tuple[Sensor, NDArray[np.float64]]:
    """The nominal sensor, and reference frames (n, M) in the board's units; of a public set one.

    Raises:
        InputError: unknown name, or a recording (.h5) without reference frames.
        DataUnavailableError, DataCorruptError: the data cannot be had, or are damaged.
    """
    if not is_recording(name):
        recording = read_recording(name)
        if recording.modelled_reference:
            raise no_untouched_frame(name)
        return recorded_set(name).sensor(), recording.reference[None]
    content, _ = undamaged(Path(name))
    if content.differences:
        raise no_untouched_frame(name)
    untouched = untouched_rows(content)
    if not len(untouched):
        raise InputError(
            f"{name} marks no reference frames: record with --guided, take a new reference on the "
            "live page while it records, or import it with --reference."
        )
    return content.sensor, content.values[untouched]
