"""Named arrays with metadata in one safetensors file: written whole, verified when read."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import DataCorruptError, EitbenchError
from eitbench.scenarios.storage.atomic_write import atomic_write
from eitbench.scenarios.storage.files import writing

AnyArray = NDArray[Any]

DIGEST = "sha256"


def write_arrays(path: Path, arrays: Mapping[str, AnyArray], metadata: Mapping[str, str]) -> None:
    """Store `arrays` with `metadata` and a checksum; a reader sees the old file or the new one.

    Raises:
        EitbenchError: the folder is not writable or full.
    """
    from safetensors.numpy import save

    # The library copies memory as it is laid out.
    arrays = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    content = save(arrays, {**metadata, DIGEST: _digest(arrays, metadata)})
    with writing(path):
        atomic_write(path, content)


def read_arrays(path: Path) -> tuple[dict[str, AnyArray], dict[str, str]] | None:
    """Return the arrays of a file and its metadata; None if there is no file.

    Raises:
        DataCorruptError: the file is damaged, or not one that `write_arrays` wrote.
        EitbenchError: the file may not be read.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        content = path.read_bytes()  # by Python, so that audit hooks see it
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EitbenchError(f"Could not read {path}: {error.strerror or error}.") from error
    try:
        arrays = load(content)
        header = content[8 : 8 + int.from_bytes(content[:8], "little")]
        metadata = dict(json.loads(header).get("__metadata__", {}))
    except (SafetensorError, KeyError, AttributeError) as error:  # or a type that NumPy lacks
        raise DataCorruptError(f"{path} is damaged: {error}.") from error
    if metadata.pop(DIGEST, None) != _digest(arrays, metadata):
        raise DataCorruptError(f"{path} is damaged: its content does not match its checksum.")
    return arrays, metadata


def _digest(arrays: Mapping[str, AnyArray], metadata: Mapping[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(dict(metadata), sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        # Types are named as torch does, which wrote the first of these files.
        digest.update(f"{name} torch.{array.dtype} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
