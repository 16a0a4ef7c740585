"""Files as every part of the package treats them: their digest, and errors as one sentence."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eitbench.scenarios.errors import EitbenchError


def sha256_of(path: Path) -> str:
    """SHA-256 (hex) of the file at `path`."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def writing(what: Path | str) -> Iterator[None]:
    """Turn an error of the file system while `what` is written into one sentence.

    Raises:
        EitbenchError: there was one.
    """
    try:
        yield
    except OSError as error:
        raise EitbenchError(f"Could not write {what}: {error.strerror or error}.") from error
