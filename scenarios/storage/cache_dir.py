"""Folder of files that can be made or downloaded again."""

import os
from pathlib import Path


def cache_dir() -> Path:
    """The folder named by the environment variable `EITBENCH_CACHE`, else the user's own cache."""
    chosen = os.environ.get("EITBENCH_CACHE")
    if chosen:
        return Path(chosen).expanduser()
    import pooch

    return Path(pooch.os_cache("eitbench"))
