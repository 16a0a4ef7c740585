"""Named tensors with a description in one safetensors file: written whole, verified when read."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

from eitbench.scenarios.atomic_write import atomic_write
from eitbench.scenarios.errors import DataCorruptError, EitbenchError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from torch import Tensor

DIGEST = "sha256"


def write_tensors(path: Path, tensors: Mapping[str, Tensor], about: Mapping[str, str]) -> None:
    """Store `tensors` and what there is to know `about` them; a reader sees all or nothing.

    Raises:
        EitbenchError: the folder is not writable or full.
    """
    from safetensors.torch import save

    stored = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    content = save(stored, dict(about) | {DIGEST: _digest(stored, about)})
    try:
        atomic_write(path, content)
    except OSError as error:
        raise EitbenchError(f"Could not write {path}: {error.strerror or error}.") from error


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]] | None:
    """The tensors on the CPU and what is known about them; None if there is no file.

    Raises:
        DataCorruptError: the file is damaged, or not one that `write_tensors` wrote.
        EitbenchError: the file may not be read.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            about = dict(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise DataCorruptError(f"{path} is damaged: {error}.") from error
    except OSError as error:
        raise EitbenchError(f"Could not read {path}: {error.strerror or error}.") from error
    if about.pop(DIGEST, None) != _digest(tensors, about):
        raise DataCorruptError(f"{path} is damaged: its content does not match its checksum.")
    return tensors, about


def _digest(tensors: Mapping[str, Tensor], about: Mapping[str, str]) -> str:
    digest = hashlib.sha256(json.dumps(dict(about), sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()
