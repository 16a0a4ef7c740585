"""Folders for results."""

from pathlib import Path

from eitbench.scenarios.errors import InputError


def check_folder(folder: Path) -> None:
    """Refuse a `folder` for results that is a file, or would lie in one.

    Raises:
        InputError: it is, or would.
    """
    for path in (folder, *folder.parents):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} is a file: name a folder with --out.")


def check_empty(folder: Path | None) -> None:
    """Refuse a `folder` for results that holds something; None passes.

    Raises:
        InputError: it does, or is no folder.
    """
    if folder is None or not folder.exists():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise InputError(f"The output {folder} is not an empty folder: choose another with --out.")
