"""Limits of memory for reading files: claimed sizes are compared with the size of the file."""

import errno
import math
import stat
from pathlib import Path
from typing import Any

EXPANSION = 200
"""Measured values, compressed, never take so many times the memory of their file."""
SPARE = 32 * 2**20
"""Memory that any file may take, however small it is [bytes]."""


def most_bytes(path: Path) -> int:
    """Greatest memory that the content of the file at `path` may take [bytes].

    Raises:
        OSError: there is no such file.
    """
    return EXPANSION * path.stat().st_size + SPARE


def check_regular(path: Path) -> None:
    """Refuse a pipe or a device, which may be read for ever.

    Raises:
        OSError: it is one, or there is no such file.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))


def own_dataset(group: Any, name: str, most: int) -> Any:
    """The h5py dataset `name` of a file or `group`, whose values stand in the same file.

    Links, datasets that lead into other files and values of variable length are refused; so are
    values that claim more than `most` bytes, in all or in the part that is unpacked at once: HDF5
    makes up values that were never written.

    Raises:
        ValueError: it is none, or is refused.
    """
    import h5py

    if isinstance(group.get(name, getlink=True), h5py.SoftLink | h5py.ExternalLink):
        raise ValueError(f"{name!r} is a link")
    part = group.get(name)
    if not isinstance(part, h5py.Dataset):
        raise ValueError(f"it has no {name!r}")
    if part.file != group.file or part.external or part.is_virtual:
        raise ValueError(f"{name!r} leads into another file")
    if part.dtype.hasobject:
        raise ValueError(f"{name!r} holds values of variable length")
    unpacked = math.prod(part.chunks or ())
    if part.size is None or max(part.size, unpacked) * part.dtype.itemsize > most:
        raise ValueError(f"{name!r} claims to be larger than the file")
    return part
