"""Memory that a worker takes, with all that it started: pages, and files that lie in memory."""

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil

from eitbench.benchmark.workers.control_group import control_group, group_memory_mb

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  (files are looked at and removed there, none made)
_IN_MEMORY = (f"{SHARED_MEMORY}/", "/memfd:")
_BLOCK = 512  # bytes: the unit of `st_blocks`


class MemoryMeter:
    """Meter of the processes below one; on Linux also of their files in memory.

    A file counts from when one of them is seen to have it open, until it is gone. One that is
    open for a moment only may not be seen, unless the processes have a control group.
    """

    def __init__(self, pid: int) -> None:
        """Measure what runs below the process `pid`."""
        self._pid, self._group = pid, control_group(pid)
        self._named: dict[tuple[int, int], Path] = {}

    def used_mb(self) -> float:
        """Return the memory that is taken [MiB]; 0 where nothing runs.

        A page that several processes map counts for each.
        """
        resident, mapped = 0, 0
        files: dict[tuple[int, int], int] = {}
        with suppress(psutil.Error):
            for process in psutil.Process(self._pid).children(recursive=True):
                with suppress(psutil.Error, OSError):
                    resident += process.memory_info().rss
                    mapped += _mapped_shared(process.pid)
                    for path, found in _open_in_memory(process.pid):
                        key = found.st_dev, found.st_ino
                        files[key] = found.st_blocks * _BLOCK
                        self._named[key] = path
        for key, path in list(self._named.items()):
            try:
                found = path.stat()
            except OSError:  # removed, or it never had a name there
                del self._named[key]
                continue
            if key == (found.st_dev, found.st_ino):
                files[key] = found.st_blocks * _BLOCK
        seen = (resident + max(0, sum(files.values()) - mapped)) / 2**20
        return max(seen, group_memory_mb(self._group))


def _open_in_memory(pid: int) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield path and status of each file in memory that the process has open."""
    for descriptor in Path(f"/proc/{pid}/fd").glob("*"):
        with suppress(OSError):  # closed meanwhile
            path = os.readlink(descriptor)  # noqa: PTH115  (it may be the name of no file)
            if path.startswith(_IN_MEMORY):
                yield Path(path), descriptor.stat()


def _mapped_shared(pid: int) -> int:
    """Return how much of its resident memory is of files in memory, or shared [B]."""
    with suppress(OSError):
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace")
        if found := re.search(r"^RssShmem:\s+(\d+) kB", status, re.MULTILINE):
            return int(found[1]) * 1024
    return 0
