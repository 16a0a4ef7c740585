"""How much of a file is believed: sizes are compared with the file's before memory is asked for."""

from pathlib import Path
from typing import Any

EXPANSION = 200
"""Measured values, compressed, never take so many times the memory of their file."""
GZIP_EXPANSION = 1100
"""Gzip (deflate) cannot hold more than 1032 times its size."""
SPARE = 32 * 2**20
"""What any file may take in memory [bytes]."""


def most_bytes(path: Path, expansion: int = EXPANSION) -> int:
    """What the content of the file at `path` may take in memory [bytes].

    Raises:
        OSError: there is no such file.
    """
    return expansion * path.stat().st_size + SPARE


def own_dataset(group: Any, name: str, most: int) -> Any:
    """The h5py dataset `name` of a file or `group`, whose values stand in the same file.

    Links and datasets that lead into other files, whose content is nobody's business here, are
    refused; so are values that claim more than `most` bytes: HDF5 makes up what was never written.

    Raises:
        ValueError: it is none, or is refused.
    """
    import h5py

    part = group.get(name)
    if not isinstance(part, h5py.Dataset):
        raise ValueError(f"it has no {name!r}")
    if part.file != group.file or part.external or part.is_virtual:
        raise ValueError(f"{name!r} leads into another file")
    if part.size is None or part.size * part.dtype.itemsize > most:
        raise ValueError(f"{name!r} claims to be larger than the file")
    return part
