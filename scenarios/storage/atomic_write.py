"""Files that appear whole or not at all, whoever writes them at once and whenever one is killed."""

import glob
import json
import os
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

# A part this old [s] was left by a killed process: writing one takes seconds. Whether that process
# lives cannot be asked, where the folder is shared by machines.
ABANDONED_AFTER_S = 3600.0


def atomic_write(path: Path, content: bytes | Callable[[Path], object]) -> None:
    """Make `content` the file `path`: others read the old file or the new, nothing between.

    A link at `path` is replaced; what it leads to stays as it is.

    Args:
        path: where it appears; its folder is made.
        content: what it holds, or a function that writes it to the path that it is given.

    Raises:
        OSError: the folder is not writable or full; nothing is left of this file.
    """
    # Nobody can foresee the name, and put a link there.
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(path)
    try:
        if isinstance(content, bytes):
            part.write_bytes(content)
        else:
            content(part)
        # On the disk before its name is: it is whole even if the machine stops.
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def atomic_write_json(path: Path, value: Any) -> None:
    """Make `value` the JSON file `path`, as `atomic_write` does, with a line for each entry.

    Raises:
        ValueError: it holds NaN or an infinity, which JSON does not know.
    """
    atomic_write(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def _sweep(path: Path) -> None:
    """Remove what killed processes left beside `path`."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        # Its writer, or another process that sweeps, may be done with it meanwhile; in a folder
        # that people share it may be somebody else's.
        with suppress(OSError):
            if time.time() - left.lstat().st_mtime > ABANDONED_AFTER_S:
                left.unlink()
