"""A control group of Linux for each worker, where the system lets us make one.

It counts what looking at processes does not show: a page belongs to the group that touched it
first, also of a file in memory that is closed already, and of a process that came and went.

Source: cgroup-v1/memory.rst and cgroup-v2.rst in Linux's Documentation/admin-guide.
"""

import re
from contextlib import suppress
from pathlib import Path

_ROOT = Path("/sys/fs/cgroup")
# Pages without a file, and of files in memory; of version 1 with those of groups below.
_COUNTED = (("total_rss", "total_shmem"), ("anon", "shmem"))


def control_group(guard: int) -> Path | None:
    """Return the folder of the group of the worker with this guard, made or not; None without."""
    with suppress(OSError):
        own = Path("/proc/self/cgroup").read_text(encoding="utf-8")
        for line, root in ((r"\d+:(?:.*,)?memory(?:,.*)?", _ROOT / "memory"), ("0:", _ROOT)):
            found = re.search(rf"^{line}:/(.*)$", own, re.MULTILINE)
            if found and (root / found[1] / "cgroup.procs").is_file():
                return root / found[1] / f"eitbench-{guard}"
    return None


def make_group(guard: int) -> Path | None:
    """Make the group of a worker and return its folder; None where that is not allowed."""
    folder = control_group(guard)
    if folder is None:
        return None
    with suppress(OSError):
        folder.mkdir()
        if (folder / "memory.stat").is_file():
            return folder
        folder.rmdir()
    return None


def enter_group(folder: Path) -> None:
    """Put this process, and all that it will start, into a group."""
    with suppress(OSError):
        (folder / "cgroup.procs").write_text("0", encoding="utf-8")


def group_memory_mb(folder: Path | None) -> float:
    """Return the memory of a group [MiB]; 0 without one."""
    if folder is None:
        return 0.0
    with suppress(OSError, ValueError):
        lines = (folder / "memory.stat").read_text(encoding="utf-8").splitlines()
        stat = {name: int(value) for name, value in map(str.split, lines)}
        for names in _COUNTED:
            if stat.keys() >= set(names):
                return sum(stat[name] for name in names) / 2**20
    return 0.0
