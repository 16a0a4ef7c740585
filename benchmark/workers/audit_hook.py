"""Notes of the files, connections and programs of a process, from Python's audit events.

Python announces what its standard library is about to do (PEP 578). Code compiled from C, Fortran
or Rust announces nothing, nor does a program that was started: this finds carelessness, and stops
nobody.
"""

import json
import os
import socket
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Literal, get_args

import eitbench
from eitbench.benchmark.workers.messages import plain_text
from eitbench.scenarios.data.simulation import split_folder
from eitbench.scenarios.storage.cache_dir import cache_dir

Kind = Literal["network", "write", "program", "read", "test data"]

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
O_PATH = getattr(os, "O_PATH", 0)  # names a file without opening it
TEMPORARY = ("TMPDIR", "TEMP", "TMP", "JOBLIB_TEMP_FOLDER")
"""Variables that name a folder for temporary files."""
# Where the paths that an event changes stand among its arguments, and the folder each is in.
CHANGES: dict[str, tuple[tuple[int, int | None], ...]] = {
    "os.chmod": ((0, 2),),
    "os.chown": ((0, 3),),
    "os.link": ((1, 3),),
    "os.mkdir": ((0, 2),),
    "os.remove": ((0, 1),),
    "os.removexattr": ((0, None),),
    "os.rename": ((0, 2), (1, 3)),
    "os.rmdir": ((0, 1),),
    "os.setxattr": ((0, None),),
    "os.symlink": ((1, 2),),
    "os.truncate": ((0, None),),
    "os.utime": ((0, 3),),
    "sqlite3.connect": ((0, None),),
}
LOOKUPS = {"socket.getaddrinfo", "socket.gethostbyaddr", "socket.gethostbyname"}
CALLS = {"socket.bind", "socket.connect", "socket.sendmsg", "socket.sendto"}
PROGRAMS = {
    "os.exec",
    "os.posix_spawn",
    "os.spawn",
    "os.startfile",
    "os.system",
    "subprocess.Popen",
}
HARMLESS = {"fc-list", "uname"}  # called by matplotlib, and by Python's `platform`
TEST_SPLIT = "eitbench.test_split"  # announced by `scenarios.guard`
PROBLEM = "eitbench.methods.problem"  # gives methods what they may learn from
MAX_NOTES = 40  # of each kind
MOST_BYTES = 2**20  # of all notes


@dataclass(frozen=True)
class Watch:
    """Notes the actions of the process that begins it, and of those it forks.

    Attributes:
        folder: a folder that exists; temporary files of the process go to a folder in it, which is
            its own to write to, as is eitbench's cache.
        recordings: files of the user that it is scored on; public recordings are known.
    """

    folder: Path
    recordings: tuple[Path, ...] = ()

    def begin(self) -> None:
        """Watch this process, from now to its end."""
        own = self.folder / "own"
        for place in own_places(self.folder):
            with suppress(OSError):  # what cannot be made cannot be written to
                place.mkdir(parents=True, exist_ok=True)
        os.environ.update(dict.fromkeys(TEMPORARY, str(own)))
        tempfile.tempdir = str(own)
        # matplotlib, which many a library imports, makes a list of fonts when it finds none.
        os.environ["MPLCONFIGDIR"] = str(cache_dir() / "matplotlib")
        notes = os.open(self._notes, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        places = [os.path.realpath(place) for place in (*own_places(self.folder), _compiled())]
        sys.addaudithook(_hook(notes, places, self._recorded()))

    def noted(self, kind: Kind) -> list[str]:
        """Return the notes of that kind, as parts of a sentence, each once, in order."""
        return self.all_noted().get(kind, [])

    def all_noted(self) -> dict[str, list[str]]:
        """Return the notes by kind; the process that is watched could have written any."""
        found: dict[str, list[str]] = {}
        with suppress(FileNotFoundError), self._notes.open("rb") as file:
            for line in file.read(MOST_BYTES).splitlines():
                with suppress(ValueError, RecursionError, TypeError):
                    kind, what = json.loads(line)
                    notes = found.setdefault(kind, []) if kind in get_args(Kind) else []
                    if (text := plain_text(str(what))) not in notes and len(notes) < MAX_NOTES:
                        notes.append(text)
        return found

    def _recorded(self) -> tuple[str, ...]:
        """Return files of recordings, and folders of them with a separator at the end."""
        folders = [cache_dir() / "recordings"]
        if given := os.environ.get("EITBENCH_DATA"):
            folders.append(Path(given).expanduser())
        files = (os.path.realpath(file) for file in self.recordings)
        return (*files, *(os.path.realpath(folder) + os.sep for folder in folders))

    @property
    def _notes(self) -> Path:
        return self.folder / "notes"


def own_places(folder: Path) -> list[Path]:
    """Return what a process watched in `folder` may write to.

    That is its own folder, and caches of what methods learn from. It is nothing that others are
    scored with.
    """
    return [folder / "own", *shared_caches()]


def shared_caches() -> list[Path]:
    """Return the caches that every method may read and write: of what it learns from, and fonts."""
    learned = [split_folder(split) for split in ("train", "validation")]
    return [*learned, cache_dir() / "matplotlib"]


def _compiled() -> Path:
    """Return the cache of compiled loops."""
    import pooch

    return Path(os.environ.get("NUMBA_CACHE_DIR") or pooch.os_cache("numba"))


def code_folder() -> Path:
    """The folder of eitbench's code: the repository, or the installed package."""
    return Path(eitbench.__path__[0]).resolve()


def _code() -> tuple[str, ...]:
    """Return the beginnings of paths of the system, of Python and of eitbench."""
    system = ("/usr", "/lib", "/etc", "/proc", "/sys", "/dev")
    places = (sys.prefix, sys.base_prefix, code_folder(), *system)
    return tuple(f"{os.path.realpath(place)}{os.sep}" for place in places)


def _for_a_problem() -> bool:
    """True if the file that is opened holds data of a split that a problem was asked for."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and frame.f_globals.get("__name__") != PROBLEM:
        frame = frame.f_back
    return frame is not None


def _hook(
    notes: int, allowed: list[str], recorded: tuple[str, ...]
) -> Callable[[str, tuple[Any, ...]], None]:
    known: dict[str, set[str]] = {kind: set() for kind in get_args(Kind)}
    own, code = tuple(place + os.sep for place in allowed), _code()
    test_data = os.path.realpath(split_folder("test")) + os.sep

    def note(kind: Kind, what: str) -> None:
        what = plain_text(what)  # or a few long names would leave no place for other notes
        if what in known[kind] or len(known[kind]) >= MAX_NOTES:
            return
        known[kind].add(what)
        with suppress(OSError):
            os.write(notes, (json.dumps([kind, what]) + "\n").encode())

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if isinstance(flags, int) and flags & WRITING:
                _note_path(path, None)
            elif isinstance(path, str | bytes | os.PathLike) and not flags & O_PATH:
                _note_reading(os.fsdecode(path))
        elif event in CHANGES:
            for place, folder in CHANGES[event]:
                _note_path(arguments[place], None if folder is None else arguments[folder])
        elif event in CALLS:
            if arguments[0].family in (socket.AF_INET, socket.AF_INET6):
                note("network", f"{event} to {arguments[1]}")
        elif event in LOOKUPS:
            note("network", f"{event} of {arguments[0]!r}")
        elif event == TEST_SPLIT:
            note("test data", "the test split was asked for")
        elif event in PROGRAMS and arguments[0] not in HARMLESS:
            note("program", f"{event} of {str(arguments[0])!r}")

    def _note_reading(path: str) -> None:
        if path.endswith((".py", ".pyc")):
            return
        path = os.path.realpath(path)
        if path.startswith(test_data) or (path.startswith(recorded) and not _for_a_problem()):
            note("test data", f"open of {path}")
        elif path not in allowed and not path.startswith((*own, *code, *recorded)):
            note("read", path)

    def _note_path(path: object, folder: object) -> None:
        changed = _resolved(path, folder)
        if changed is None or changed == os.devnull or "__pycache__" in Path(changed).parts:
            return
        if not (changed in allowed or changed.startswith(own)):
            note("write", changed)

    return hook


def _resolved(path: object, folder: object) -> str | None:
    """Return the real path of `path`, relative to the open `folder`; None without a name."""
    if not isinstance(path, str | bytes | os.PathLike):
        return None  # a file that is open already
    name = os.fsdecode(path)
    if name == ":memory:":  # of a database
        return None
    if isinstance(folder, int) and folder >= 0 and not Path(name).is_absolute():
        try:
            name = str(Path(f"/proc/self/fd/{folder}").readlink() / name)
        except OSError:  # not on Linux
            return None
    return os.path.realpath(name)
