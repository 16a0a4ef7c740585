"""One file of the cache of simulated voltages: written whole or not at all, verified when read."""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.atomic_write import atomic_write
from eitbench.scenarios.errors import DataCorruptError, EitbenchError
from eitbench.scenarios.limits import own_dataset

Array = NDArray[np.float64]

DIGEST = hashlib.sha256().digest_size
"""Bytes at the end of a file that HDF5 does not look at: the SHA-256 of all before them."""

# What h5py raises on damaged content, found by altering files at random.
_DAMAGE = (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError, MemoryError)


@dataclass(frozen=True)
class CacheFile:
    """Voltages stored with the parameters they were made from.

    Attributes:
        path: the HDF5 file, with its checksum at the end.
        parameters: all that decides its content, as plain values.
    """

    path: Path
    parameters: Mapping[str, object]

    def read(self) -> Array | None:
        """The stored voltages (n, M), or None if there is no file.

        Raises:
            DataCorruptError: the file is damaged or was made from other parameters.
            EitbenchError: the file may not be read.
        """
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._unusable("read", error) from error
        # Before HDF5 sees it, which asks for gigabytes where some bytes are wrong.
        if hashlib.sha256(content[:-DIGEST]).digest() != content[-DIGEST:]:
            raise DataCorruptError(f"The cache file {self.path} does not match its checksum.")
        try:
            # From memory: HDF5's own file locks would hold up concurrent processes.
            with h5py.File(io.BytesIO(content), "r") as file:
                part = own_dataset(file, "voltages", len(content))
                voltages = np.asarray(part[()], dtype=np.float64)
                stored = str(file.attrs["parameters"])
        except _DAMAGE as error:
            raise DataCorruptError(f"The cache file {self.path} is unreadable.") from error
        if stored != self._parameters_text():
            raise DataCorruptError(f"The cache file {self.path} was made from other parameters.")
        return voltages

    def write(self, voltages: Array) -> None:
        """Store `voltages` (n, M); other processes see the old file or the new, nothing between.

        Raises:
            EitbenchError: the folder is not writable or full.
        """
        buffer = io.BytesIO()
        with h5py.File(buffer, "w") as file:
            file["voltages"] = voltages
            file.attrs["parameters"] = self._parameters_text()
        content = buffer.getvalue()
        try:
            atomic_write(self.path, content + hashlib.sha256(content).digest())
        except OSError as error:
            raise self._unusable("write", error) from error

    def _unusable(self, action: str, error: OSError) -> EitbenchError:
        return EitbenchError(
            f"Cannot {action} the cache file {self.path} ({error.strerror or error}): make room or "
            "give access there, or set EITBENCH_CACHE to another folder."
        )

    def _parameters_text(self) -> str:
        return json.dumps(self.parameters, sort_keys=True, allow_nan=False)
