"""The HDF5 layout of own recordings: names, types, checksums; docs/recording.md describes it.

Everything that grows is a dataset that is only ever appended to and holds values of fixed size, as
HDF5's single-writer mode asks for: so a file is whole after every flush, whatever happens next.
"""

import hashlib
import json
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

FORMAT = "eitbench-recording"
VERSION = 2

VALUES = "frames/values"
NUMBER = "frames/number"
TIME = "frames/time_s"
RECEIVED = "frames/received_s"
CRC = "frames/crc32"
PATTERN = "pattern"
REFERENCE = "reference"
LABELS = "labels"
EVENTS = "events"
COMPLETE = "complete"
SHA256 = "sha256"

UNITS = {
    VALUES: "V/A, or the board's own units",
    NUMBER: "1",
    TIME: "s",
    RECEIVED: "s",
    CRC: "1",
    PATTERN: "electrodes src, sink, a, b, from 0",
    REFERENCE: "rows of frames",
    LABELS: "rows of frames; m; mm; N; Pa",
    EVENTS: "s",
}

STATE_BYTES, TEXT_BYTES = 64, 256
LABEL = np.dtype(
    [
        ("first", "<i8"),
        ("last", "<i8"),
        ("x_m", "<f8"),
        ("y_m", "<f8"),
        ("depth_mm", "<f8"),
        ("force_N", "<f8"),
        ("pressure_Pa", "<f8"),
        ("state", f"S{STATE_BYTES}"),
        ("reference_first", "<i8"),
        ("reference_last", "<i8"),
    ]
)
LABEL_NUMBERS = ("x_m", "y_m", "depth_mm", "force_N", "pressure_Pa")
"""Columns of labels that hold a number where it is known, and NaN where it is not."""
EVENT = np.dtype([("time_s", "<f8"), ("text", f"S{TEXT_BYTES}")])
ROW_TYPES = {NUMBER: "<i8", TIME: "<f8", RECEIVED: "<f8", CRC: "<u4"}
TABLE_TYPES = {REFERENCE: np.dtype("<i8"), LABELS: LABEL, EVENTS: EVENT}

Bytes = NDArray[np.uint8]


def fitted(text: str, size: int) -> bytes:
    """`text` as UTF-8 of at most `size` bytes; whole characters are left out at its end."""
    # A zero byte would end it.
    return text.replace("\0", " ").encode()[:size].decode(errors="ignore").encode()


def packed(
    number: NDArray[np.int64],
    time_s: NDArray[np.float64],
    received_s: NDArray[np.float64],
    values: NDArray[np.float64],
) -> Bytes:
    """The bytes (n, 8 (3 + M)) of n frames that checksums are taken of, little-endian."""
    columns = [
        np.ascontiguousarray(number, "<i8").view("<u8")[:, None],
        np.ascontiguousarray(time_s, "<f8").view("<u8")[:, None],
        np.ascontiguousarray(received_s, "<f8").view("<u8")[:, None],
        np.ascontiguousarray(values, "<f8").view("<u8"),
    ]
    return np.concatenate(columns, axis=1).view(np.uint8)


def checksums(frames: Bytes) -> NDArray[np.uint32]:
    """CRC-32 (n,) of every row of `packed` frames."""
    return np.fromiter((zlib.crc32(row) for row in frames), dtype=np.uint32, count=len(frames))


def content_digest(
    header: Mapping[str, object], frames: bytes, tables: Mapping[str, NDArray[np.generic]]
) -> str:
    """SHA-256 (hex) of a whole recording.

    Args:
        header: board, firmware, emulated, started, differences and sensor.
        frames: SHA-256 of all `packed` frames, one after the other.
        tables: reference, labels and events.
    """
    digest = hashlib.sha256(json.dumps(dict(header), sort_keys=True).encode())
    digest.update(frames)
    for name, kind in TABLE_TYPES.items():
        digest.update(np.ascontiguousarray(tables[name], kind).tobytes())
    return digest.hexdigest()
