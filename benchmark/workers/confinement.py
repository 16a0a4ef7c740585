"""Confinement of a worker: it is watched, and writes to a temporary folder and caches of its own.

On Linux the kernel keeps it so (Landlock, 6.2 and newer): a process gives up rights, without any
privilege, for itself and all that it starts, and cannot take them back. It then can neither change
files elsewhere nor look into, or write to, the memory of processes outside; from 6.12 on it cannot
send them signals. Elsewhere it is watched only.
"""

import ctypes
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import util
from pathlib import Path

from eitbench.benchmark.workers.audit_hook import Watch, code_folder, own_places, shared_caches
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.storage.cache_dir import cache_dir

# linux/landlock.h; the numbers of these calls are the same on all its architectures.
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_PATH_BENEATH = 1
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR, _TRUNCATE = 1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 14
_WRITING = _WRITE_FILE | _TRUNCATE | sum(1 << bit for bit in range(4, 14))  # make, remove, refer
_READING = _EXECUTE | _READ_FILE | _READ_DIR
_SCOPES = 0b11  # no signals and no abstract sockets to processes outside
_TRUNCATE_ABI, _SCOPES_ABI = 3, 6
_APPARMOR = Path("/proc/sys/kernel/apparmor_restrict_unprivileged_userns")
# linux/prctl.h, linux/sched.h, linux/mount.h
_PR_SET_NO_NEW_PRIVS = 38
_MOUNTS_AND_USERS, _NETWORK = 0x20000 | 0x10000000, 0x40000000  # kinds of namespaces
# Programs, libraries and devices; what else an isolated worker may read is its own.
_SYSTEM = ("/usr", "/bin", "/lib", "/lib64", "/sbin", "/etc", "/opt", "/proc", "/sys", "/dev")


@dataclass(frozen=True)
class Confinement:
    """The limits of a worker.

    Attributes:
        folder: a folder that exists, for its temporary files and what is noted of it.
        readable: files and folders that it may read, beside those of the system, of Python and its
            own; None: all. A worker that may not read all has no network either.
        recordings: as those of `Watch`.
    """

    folder: Path
    readable: tuple[Path, ...] | None = None
    recordings: tuple[Path, ...] = ()

    @property
    def watch(self) -> Watch:
        """Notes of what the worker does."""
        return Watch(self.folder, self.recordings)

    def begin(self) -> None:
        """Confine this process, from now to its end; it must have one thread.

        Raises:
            OSError: the kernel does not isolate it.
        """
        if self.readable is not None:
            # Before anything is noted: this is not what the method does.
            _hide(("/run", util.get_temp_dir()), _NETWORK)
        elif landlock_abi() >= _TRUNCATE_ABI and _may_hide():
            with suppress(OSError):  # where that is allowed
                _hide((util.get_temp_dir(),))
        self.watch.begin()
        _keep_machine_code(self.folder / "own")
        writable = own_places(self.folder)
        if self.readable is not None:
            _restrict(writable, (*self.readable, cache_dir() / "weights", *_needed()))
        elif landlock_abi() >= _TRUNCATE_ABI:
            _restrict(writable, None)


def landlock_abi() -> int:
    """Return the version of Landlock that the kernel offers, 0 without any."""
    if sys.platform != "linux":
        return 0
    return max(0, int(ctypes.CDLL(None).syscall(_CREATE_RULESET, None, 0, 1)))


def check_isolation() -> None:
    """Check that workers can be isolated on this machine.

    Raises:
        InputError: they cannot.
    """
    if landlock_abi() < _SCOPES_ABI:
        raise InputError(
            "--isolate needs Linux 6.12 or newer with Landlock: run in a container or a virtual "
            "machine instead."
        )
    if not _may_hide():
        raise InputError(
            "--isolate needs user namespaces with rights of their own, which AppArmor forbids "
            "here: run `sudo sysctl -w kernel.apparmor_restrict_unprivileged_userns=0`, or in a "
            "container or a virtual machine."
        )
    # In another process: leaving cannot be taken back, and this one may have many threads.
    kinds = _MOUNTS_AND_USERS | _NETWORK
    leave = f"import ctypes; raise SystemExit(ctypes.CDLL(None).unshare({kinds}) != 0)"
    if subprocess.run([sys.executable, "-I", "-c", leave], check=False).returncode:
        raise InputError(
            "--isolate needs user namespaces, which this machine does not allow: run in a "
            "container or a virtual machine instead."
        )


def check_unreadable(place: Path) -> None:
    """Check that isolated workers cannot read what is at `place`.

    Raises:
        InputError: it lies in a folder that they may read.
    """
    named = [os.environ.get(name) for name in ("EITBENCH_DATA", "EITBENCH_EIDORS")]
    caches = [cache_dir() / "weights", cache_dir() / "recordings", *shared_caches()]
    for folder in (*_needed(), *caches, *(Path(name) for name in named if name)):
        if place.resolve().is_relative_to(folder.resolve()):
            raise InputError(
                f"{place} lies in {folder}, which isolated methods may read: name a place outside "
                "of the checkout, of Python, of recordings, of caches and of the system."
            )


def _keep_machine_code(folder: Path) -> None:
    """Let numba compile in memory what is not on the disk; it fails where it cannot write."""
    import numba
    from numba.core.caching import FunctionCache

    vars(numba.config)["CACHE_DIR"] = str(folder)
    setattr(FunctionCache, "save_overload", lambda *_: None)  # noqa: B010


def _needed() -> list[Path]:
    """Return what Python, and eitbench, are read from."""
    places = [sys.prefix, sys.base_prefix, *(place for place in sys.path if place)]
    return [*map(Path, (*_SYSTEM, *places)), code_folder()]


def _restrict(writable: Sequence[Path], readable: Sequence[Path] | None) -> None:
    """Give up the right to write, and to read unless `readable` is None, anywhere else."""
    libc = ctypes.CDLL(None, use_errno=True)
    abi = landlock_abi()
    handled = _WRITING if readable is None else _WRITING | _READING
    # struct landlock_ruleset_attr: handled_access_fs, handled_access_net, scoped
    attributes = (ctypes.c_uint64 * 3)(handled, 0, _SCOPES if abi >= _SCOPES_ABI else 0)
    size = 24 if abi >= _SCOPES_ABI else 8
    ruleset = _called(libc.syscall, _CREATE_RULESET, ctypes.byref(attributes), size, 0)
    rules = [(place, handled) for place in writable]
    rules += [(Path("/dev"), handled & ~(_EXECUTE | sum(1 << bit for bit in range(4, 12))))]
    rules += [(Path("/dev/shm"), handled)]  # noqa: S108  (semaphores and shared memory)
    rules += [(place, _READING) for place in readable or ()]
    for place, rights in rules:
        try:
            opened = os.open(place, os.O_PATH | os.O_CLOEXEC)
        except OSError:
            continue  # it is not there
        if not place.is_dir():
            rights &= _EXECUTE | _WRITE_FILE | _READ_FILE | _TRUNCATE
        # struct landlock_path_beneath_attr, packed: allowed_access, parent_fd
        rule = rights.to_bytes(8, sys.byteorder) + opened.to_bytes(4, sys.byteorder)
        _called(libc.syscall, _ADD_RULE, ruleset, _PATH_BENEATH, rule, 0)
        os.close(opened)
    _called(libc.prctl, _PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    _called(libc.syscall, _RESTRICT_SELF, ruleset, 0)
    os.close(ruleset)


def _may_hide() -> bool:
    """False where AppArmor lets users make a namespace in which they may do nothing."""
    try:
        forbidden = _APPARMOR.read_text().strip() == "1"
    except OSError:  # no AppArmor
        forbidden = False
    return not forbidden or os.geteuid() == 0


def _hide(folders: Sequence[str], more: int = 0) -> None:
    """Hide folders, such as that with the socket of the server of processes, which asks nobody who
    he is; and leave `more` namespaces.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    user, group = os.getuid(), os.getgid()
    _called(libc.unshare, _MOUNTS_AND_USERS | more)
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
    Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    for folder in folders:
        if Path(folder).is_dir():
            _called(libc.mount, b"none", os.fsencode(folder), b"tmpfs", 0, None)


def _called(function: "ctypes._NamedFuncPointer", *arguments: object) -> int:
    """Call a function of the C library.

    Raises:
        OSError: it failed.
    """
    result = int(function(*arguments))
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result
