"""Reading own recordings, also those that were cut off; see `layout`."""

import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from eitbench.scenarios.arrays import Array, Mask
from eitbench.scenarios.errors import DataCorruptError, InputError, UnreadableError
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.sensor_file import sensor_from_json, sensor_to_json
from eitbench.scenarios.storage.limits import check_regular, own_dataset


@dataclass(frozen=True, eq=False)
class Content:
    """Content of a recording.

    Attributes:
        sensor: the nominal sensor; its pattern gives the order of the values.
        board, firmware: names of the hardware that recorded it.
        emulated: no real sensor was measured.
        started: when it began, ISO 8601 in UTC; "unknown" of what was imported.
        number: (n,) running number of every frame; a gap is a lost frame.
        time_s: (n,) when it was measured [s], on the board's clock.
        received_s: (n,) when it was received [s], on the recording machine's clock.
        values: (n, M) in V/A, or the board's own units.
        reference: (r,) rows of frames that show the untouched sensor.
        labels: one row per contact: `first` and `last` row of its frames, `x_m`, `y_m` [m],
            `depth_mm`, `force_N` and `pressure_Pa` (NaN where unknown), `state` ("" where unknown),
            `reference_first` and `reference_last` row of the frames that show the untouched sensor
            for this touch (-1 where `reference` counts). Rows with equal `first` and `last` are the
            contacts of one touch.
        events: `time_s` [s] on the clock of `received_s`, and `text`.
        differences: `values` are pressed minus released, and no frame shows the untouched sensor.
    """

    sensor: Sensor
    board: str
    firmware: str
    emulated: bool
    started: str
    number: NDArray[np.int64]
    time_s: Array
    received_s: Array
    values: Array
    reference: NDArray[np.int64]
    labels: pd.DataFrame
    events: pd.DataFrame
    differences: bool = False

    def __len__(self) -> int:
        """Number of frames n."""
        return len(self.values)


@dataclass(frozen=True)
class Condition:
    """Condition of a recording's file.

    Attributes:
        complete: it was closed as it should be.
        trimmed: frames at its end that were not written whole, and are left out.
        unlabelled: labels of such frames, which are left out with them.
        damaged: rows of frames whose checksum is wrong.
        sealed: a complete file still holds what it held when it was closed.
    """

    complete: bool
    trimmed: int
    unlabelled: int
    damaged: tuple[int, ...]
    sealed: bool


def read_file(path: Path) -> tuple[Content, Condition]:
    """Read content and condition of the recording at `path`, which may still be written to.

    Raises:
        UnreadableError: there is no such file, or it may not be read.
        DataCorruptError: no recording, or one whose parts do not fit together.
    """
    header, parts = _parts(path)
    sensor = _sensor(path, header, parts)
    columns = [parts[n] for n in (layout.NUMBER, layout.TIME, layout.RECEIVED, layout.VALUES)]
    # What the columns share is whole: a crash may leave some of them longer than others.
    lengths = [len(column) for column in (*columns, parts[layout.CRC])]
    n = min(lengths)
    frames = layout.packed(*(column[:n] for column in columns))
    wrong = layout.checksums(frames) != parts[layout.CRC][:n]
    complete = bool(parts[layout.COMPLETE])
    kept = n if complete else max(np.flatnonzero(~wrong).tolist(), default=-1) + 1
    number, time_s, received_s, values = (column[:kept] for column in columns)
    reference, labels = parts[layout.REFERENCE], table_of(parts[layout.LABELS])
    whole: Mask = np.ones(len(labels), dtype=bool)
    if not complete:
        reference = reference[reference < kept]
        rows = labels[["first", "last", "reference_first", "reference_last"]].to_numpy()
        whole = np.all(rows < kept, axis=1)
    digest = layout.content_digest(header, hashlib.sha256(frames[:kept].tobytes()).digest(), parts)
    content = Content(
        **(header | {"sensor": sensor}),
        number=number,
        time_s=time_s,
        received_s=received_s,
        values=values,
        reference=reference,
        labels=labels[whole].reset_index(drop=True),
        events=table_of(parts[layout.EVENTS]),
    )
    condition = Condition(
        complete=complete,
        trimmed=max(lengths) - kept,
        unlabelled=int((~whole).sum()),
        damaged=tuple(np.flatnonzero(wrong[:kept]).tolist()),
        sealed=complete and digest.encode() == bytes(parts[layout.SHA256]),
    )
    return content, condition


def recorded_sensor(path: Path) -> Sensor:
    """The sensor of the recording at `path`.

    Raises:
        UnreadableError, DataCorruptError: as for `read_file`.
    """
    return read_file(path)[0].sensor


def label_table(
    first: ArrayLike, last: ArrayLike, known: Mapping[str, ArrayLike] | None = None
) -> pd.DataFrame:
    """Labels of `Content` for rows `first` to `last` (k,) of frames; what is not `known` is not."""
    rows = np.zeros(len(np.asarray(first)), dtype=layout.LABEL)
    table = table_of(rows).assign(**dict.fromkeys(layout.LABEL_NUMBERS, np.nan))
    table = table.assign(reference_first=-1, reference_last=-1)
    columns = {"first": first, "last": last, **(known or {})}
    return table.assign(**{name: np.asarray(values) for name, values in columns.items()})


def touches_of(labels: pd.DataFrame) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """Number of its touch (k,), and its own number in that touch (k,), of every label, from 0."""
    touches = labels.groupby(["first", "last"], sort=False)
    return touches.ngroup().to_numpy(), touches.cumcount().to_numpy()


def table_of(rows: NDArray[Any]) -> pd.DataFrame:
    """Rows of the layout as a table of `Content`."""
    names = rows.dtype.names or ()
    columns = {
        name: [bytes(text).decode(errors="replace") for text in rows[name]]
        if rows.dtype[name].kind == "S"
        else np.array(rows[name])
        for name in names
    }
    return pd.DataFrame(columns, columns=list(names))


def table_rows(table: pd.DataFrame, kind: np.dtype[Any]) -> NDArray[Any]:
    """A table of `Content` as rows of the layout's `kind`."""
    rows = np.zeros(len(table), dtype=kind)
    for name in kind.names or ():
        text = kind[name].kind == "S"
        size = kind[name].itemsize
        rows[name] = [layout.fitted(t, size) for t in table[name]] if text else table[name]
    return rows


def header_of(content: Content) -> dict[str, Any]:
    """The part of a recording that is written before its first frame."""
    return {
        "board": content.board,
        "firmware": content.firmware,
        "emulated": content.emulated,
        "started": content.started,
        "differences": content.differences,
        "sensor": sensor_to_json(content.sensor),
    }


def _parts(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and datasets of the file at `path`, of the right types but not yet compared."""
    with _open(path) as file:
        try:
            return _header(file), _datasets(file, path.stat().st_size)
        # HDF5 fails in whatever way the damage leads to.
        except Exception as error:
            reason = str(error) if isinstance(error, ValueError) else "a part cannot be read"
            raise DataCorruptError(f"{path} is damaged: {reason}.") from error


def _open(path: Path) -> Any:
    import h5py

    try:
        check_regular(path)
        with path.open("rb") as stream:
            head = stream.read(8)
        source = _readable(path)
    except OSError as error:
        raise UnreadableError(f"Cannot read the recording {path}: {error.strerror}.") from error
    if head != b"\x89HDF\r\n\x1a\n":
        raise DataCorruptError(f"{path} is not an HDF5 file, so it is no recording of eitbench's.")
    try:
        file = h5py.File(source, "r")
    except Exception as error:
        cut = "truncated" in str(error)
        reason = "it was cut short" if cut else "HDF5 cannot open it"
        raise DataCorruptError(f"{path} is damaged: {reason}.") from error
    try:
        found = bytes(file.attrs["format"]).decode(), int(file.attrs["version"])
    except Exception:
        found = "", 0
    if found != (layout.FORMAT, layout.VERSION):
        file.close()
        raise DataCorruptError(
            f"{path} is no recording of layout {layout.VERSION}, the only one that this version of "
            "eitbench reads."
        )
    return file


def _header(file: Any) -> dict[str, Any]:
    header: dict[str, Any] = {
        name: bytes(file.attrs[name]).decode()
        for name in ("board", "firmware", "started", "sensor")
    }
    header |= {name: bool(file.attrs[name]) for name in ("emulated", "differences")}
    return header


def _datasets(file: Any, size: int) -> dict[str, NDArray[Any]]:
    kinds: dict[str, tuple[Any, int]] = {
        layout.VALUES: ("<f8", 2),
        layout.PATTERN: ("<i8", 2),
        layout.COMPLETE: ("u1", 0),
        layout.SHA256: ("S64", 0),
        **{name: (kind, 1) for name, kind in layout.ROW_TYPES.items()},
        **{name: (kind, 1) for name, kind in layout.TABLE_TYPES.items()},
    }
    found = {}
    for name, (kind, dimensions) in kinds.items():
        # Nothing is compressed, so that a damaged size cannot ask for more memory than there is.
        part = own_dataset(file, name, size + (1 << 20))
        if part.dtype != np.dtype(kind) or len(part.shape) != dimensions:
            raise ValueError(f"{name!r} is not of the right type")
        found[name] = np.asarray(part[()])
    return found


def _sensor(path: Path, header: dict[str, Any], parts: dict[str, NDArray[Any]]) -> Sensor:
    try:
        sensor = sensor_from_json(header["sensor"])
    except InputError as error:
        raise DataCorruptError(f"{path} is damaged: {error}") from error
    if not (
        np.array_equal(parts[layout.PATTERN], sensor.pattern.table)
        and parts[layout.VALUES].shape[1] == sensor.n_measurements
    ):
        raise DataCorruptError(f"{path} is damaged: its pattern is not that of its sensor.")
    return sensor


_FLAGS, _END, _CHECKSUM = 11, slice(28, 36), slice(44, 48)
_VERSION, _OPEN = 8, 0b101  # being written to, by one writer beside readers


def _readable(path: Path) -> Path | io.BytesIO:
    """`path`, or the content of the file there where it was not closed.

    HDF5's own mode for that tries again and again where a file is damaged.
    """
    with path.open("rb") as file:
        head = file.read(_CHECKSUM.stop)
        if len(head) < _CHECKSUM.stop or head[_VERSION] != 3 or not head[_FLAGS] & _OPEN:
            return path
        content = bytearray(head + file.read())
    content[_FLAGS] = 0
    # What was written is as much as there is; the writer would have noted that when it closes.
    content[_END] = len(content).to_bytes(8, "little")
    content[_CHECKSUM] = _lookup3(bytes(content[: _CHECKSUM.start])).to_bytes(4, "little")
    return io.BytesIO(content)


def _lookup3(data: bytes) -> int:
    """Jenkins' hash `hashlittle` of `data` (not empty), with which HDF5 guards its metadata.

    Source: B. Jenkins, lookup3.c, public domain, 2006.
    """
    mask = 0xFFFFFFFF

    def rotated(x: int, k: int) -> int:
        return (x << k | x >> (32 - k)) & mask

    a = b = c = (0xDEADBEEF + len(data)) & mask
    blocks = [data[k : k + 12] for k in range(0, len(data), 12)]
    for block in blocks:
        whole = block.ljust(12, b"\0")
        a = (a + int.from_bytes(whole[:4], "little")) & mask
        b = (b + int.from_bytes(whole[4:8], "little")) & mask
        c = (c + int.from_bytes(whole[8:], "little")) & mask
        if block is blocks[-1]:
            break
        for k in (4, 6, 8, 16, 19, 4):
            a = ((a - c) & mask) ^ rotated(c, k)
            c = (c + b) & mask
            a, b, c = b, c, a
    for k in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - rotated(b, k)) & mask
        a, b, c = b, c, a
    # The rounds leave the last result, c, as b.
    return b
