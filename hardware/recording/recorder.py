"""Recorder of frames into a file that stays readable; see `recordings.files.layout`."""

import errno
import hashlib
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Frame
from eitbench.scenarios.errors import EitbenchError, InputError
from eitbench.scenarios.recordings.files import layout
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.sensors.sensor_file import sensor_from_json, sensor_to_json

FLUSH_S = 0.25
"""Time until appended frames are on the disk, beside the time that writing takes [s]."""
_CHUNK_BYTES = 1 << 16
# Room that is taken before anything is written: a full disk is met while the file is whole.
_RESERVE_BYTES = 1 << 20
_FULL = {errno.ENOSPC, errno.EFBIG, errno.EDQUOT}
_END_OF_FILE = slice(28, 36)  # where HDF5's superblock (version 3) says how long the file is


class RecorderError(EitbenchError):
    """A recording cannot go on; what was written until then is readable."""


@dataclass
class _Pending:
    """Frames and rows that were appended and are not yet written."""

    frames: list[Frame] = field(default_factory=list)
    rows: dict[str, list[Any]] = field(
        default_factory=lambda: {name: [] for name in layout.TABLE_TYPES}
    )

    def __bool__(self) -> bool:
        return bool(self.frames) or any(self.rows.values())


def check_new(path: Path) -> None:
    """Refuse what cannot be the name of a new recording.

    Raises:
        InputError: the file exists already, or its name does not end in .h5.
    """
    if path.suffix != ".h5":
        raise InputError(f"A recording's name ends in .h5, got {path}.")
    if path.exists():
        raise InputError(f"{path} exists already and is never overwritten: name another file.")


class Recorder:
    """A recording in the making.

    Appending returns at once: a thread of its own writes several times a second, and has the system
    bring it to the disk, so that a crash or a kill loses no more than the last second.

    Args:
        path: of the new file, which ends in .h5.
        sensor: on the board.
        board: name of the board.
        firmware: what it says of itself.
        emulated: no real sensor is measured.
        started: when the recording began, ISO 8601 in UTC; now by default.
        differences: its frames are pressed minus released.

    Attributes:
        count: frames appended.
        written: frames that are in the file.

    Raises:
        InputError: the file exists already, or its name does not end in .h5.
        RecorderError: it cannot be written, which a later call may be the first to say, or (at the
            end of a `with`) holds no frame and is removed.
    """

    def __init__(
        self,
        path: Path,
        sensor: Sensor,
        board: str,
        *,
        firmware: str = "",
        emulated: bool = False,
        started: str | None = None,
        differences: bool = False,
    ) -> None:
        check_new(path)
        sensor_from_json(sensor_to_json(sensor))  # as readers will
        self.path, self.sensor = path, sensor
        self._header: dict[str, object] = {
            "board": board,
            "firmware": firmware,
            "emulated": emulated,
            "started": started or datetime.now(UTC).isoformat(timespec="milliseconds"),
            "differences": differences,
            "sensor": sensor_to_json(sensor),
        }
        self._file = self._create()
        self._descriptor: int = self._file.id.get_vfd_handle()
        self._reserved = 0
        self._digest = hashlib.sha256()
        self.count = self.written = 0
        self._failure: RecorderError | None = None
        self._pending, self._lock = _Pending(), threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"record {path.name}", daemon=True)
        try:
            self._reserve_and(self._lay_out)
        except RecorderError:
            with suppress(OSError, RuntimeError):
                self._file.close()
            path.unlink()
            raise
        self._thread.start()

    def append(self, frame: Frame) -> None:
        """Append `frame`.

        Raises:
            InputError: another number of values than the sensor's pattern has.
            RecorderError: what was appended before could not be written.
        """
        if frame.values.shape != (self.sensor.n_measurements,):
            raise InputError(
                f"The pattern of {self.sensor.name!r} has {self.sensor.n_measurements} values, and "
                f"a frame has {frame.values.size}: choose the sensor that is on the board."
            )
        self._check()
        with self._lock:
            self._pending.frames.append(frame)
            self.count += 1

    def event(self, text: str, time_s: float) -> None:
        """Note `text`, which happened at `time_s` on the clock of `Frame.received_s` [s]."""
        self._add(layout.EVENTS, (time_s, layout.fitted(text, layout.TEXT_BYTES)))

    def label(
        self,
        first: int,
        last: int,
        *,
        x_m: float = float("nan"),
        y_m: float = float("nan"),
        depth_mm: float = float("nan"),
        force_N: float = float("nan"),
        pressure_Pa: float = float("nan"),
        state: str = "",
        reference_first: int = -1,
        reference_last: int = -1,
    ) -> None:
        """Say that frames `first` to `last` (rows, from 0) show a contact; see `Content.labels`."""
        numbers = (x_m, y_m, depth_mm, force_N, pressure_Pa)
        named = layout.fitted(state, layout.STATE_BYTES)
        row = (first, last, *numbers, named, reference_first, reference_last)
        self._add(layout.LABELS, row)

    def mark_reference(self, first: int, last: int) -> None:
        """Say that frames `first` to `last` (rows, from 0) show the untouched sensor."""
        self._add(layout.REFERENCE, *range(first, last + 1))

    def close(self) -> None:
        """Write the rest, its checksum and that it is complete; no error if closed already.

        Raises:
            RecorderError: something that was appended could not be written.
        """
        if not self._file:
            return
        self._stopping.set()
        self._thread.join()
        try:
            self._take_and_write()
            self._check()
            self._seal()
        finally:
            self._let_go()
        self._trim()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        finally:
            # What holds no frame must not be in the way of another attempt.
            if not self.written:
                self.path.unlink()
        if kind is None and not self.written:
            raise RecorderError(
                f"Not one frame arrived, so that there is no recording {self.path}: see whether "
                "the board measures, and record for longer."
            )

    def _create(self) -> Any:
        import h5py

        try:
            file = h5py.File(self.path, "x", libver="latest")
        except OSError as error:
            check_new(self.path)  # another program may just have made it
            if not self.path.parent.is_dir():
                raise RecorderError(
                    f"Cannot write the recording {self.path}: make the folder {self.path.parent} "
                    "first."
                ) from error
            reason = os.strerror(error.errno) if error.errno else str(error)
            raise RecorderError(f"Cannot write the recording {self.path}: {reason}.") from error
        return file

    def _lay_out(self) -> None:
        """Make every dataset, for frames to be appended to."""
        file = self._file
        file.attrs["format"] = np.bytes_(layout.FORMAT)
        file.attrs["version"] = layout.VERSION
        for name, value in self._header.items():
            # Fixed-size text, which HDF5 keeps beside its name.
            file.attrs[name] = np.bytes_(value.encode()) if isinstance(value, str) else value
        m = self.sensor.n_measurements
        rows = max(1, _CHUNK_BYTES // (8 * m))
        shapes: dict[str, tuple[Any, tuple[int, ...], tuple[int, ...]]] = {
            layout.VALUES: ("<f8", (0, m), (rows, m)),
            **{name: (kind, (0,), (1024,)) for name, kind in layout.ROW_TYPES.items()},
            **{name: (kind, (0,), (64,)) for name, kind in layout.TABLE_TYPES.items()},
        }
        for name, (kind, shape, chunks) in shapes.items():
            file.create_dataset(name, shape, dtype=kind, chunks=chunks, maxshape=(None, *shape[1:]))
        file.create_dataset(layout.PATTERN, data=self.sensor.pattern.table.astype("<i8"))
        file.create_dataset(layout.COMPLETE, (), dtype="u1")
        file.create_dataset(layout.SHA256, (), dtype="S64")
        for name, units in layout.UNITS.items():
            file[name].attrs["units"] = np.bytes_(units)
        file.swmr_mode = True
        self._flush()

    def _add(self, table: str, *rows: Any) -> None:
        self._check()
        with self._lock:
            self._pending.rows[table].extend(rows)

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        while not self._stopping.wait(FLUSH_S) and self._failure is None:
            self._take_and_write()

    def _take_and_write(self) -> None:
        with self._lock:
            pending, self._pending = self._pending, _Pending()
        if not pending or self._failure is not None:
            return
        try:
            self._write(pending)
        except RecorderError as error:
            self._failure = error
        except Exception as error:  # what is lost must not be followed by more
            self._failure = RecorderError(
                f"The recording {self.path} was stopped by a {type(error).__name__} ({error}): the "
                f"{self.written} frames until then are in it."
            )

    def _write(self, pending: _Pending) -> None:
        """Append and bring to the disk, in an order that leaves the file whole at every moment."""
        frames = pending.frames
        columns: dict[str, NDArray[Any]] = {
            layout.VALUES: np.array([f.values for f in frames], dtype="<f8"),
            layout.NUMBER: np.array([f.number for f in frames], dtype="<i8"),
            layout.TIME: np.array([f.time_s for f in frames], dtype="<f8"),
            layout.RECEIVED: np.array([f.received_s for f in frames], dtype="<f8"),
        }
        tables = {
            name: np.array(pending.rows[name], dtype=kind)
            for name, kind in layout.TABLE_TYPES.items()
        }
        size = sum(part.nbytes for part in (*columns.values(), *tables.values()))

        def write() -> None:
            if frames:
                packed = layout.packed(
                    columns[layout.NUMBER],
                    columns[layout.TIME],
                    columns[layout.RECEIVED],
                    columns[layout.VALUES],
                )
                columns[layout.CRC] = layout.checksums(packed)
                for name, values in columns.items():
                    self._append(name, values)
                self._digest.update(packed.tobytes())
            for name, rows in tables.items():
                self._append(name, rows)
            self._flush()
            self.written += len(frames)

        self._reserve_and(write, size)

    def _reserve_and(self, write: Callable[[], None], size: int = 0) -> None:
        """Take room for `size` bytes, and `write` them.

        Raises:
            RecorderError: there is no room, or they cannot be written.
        """
        try:
            self._reserve(size)
            write()
        except (OSError, RuntimeError, ValueError) as error:
            number = getattr(error, "errno", None)
            reason = "the disk is full" if number in _FULL else f"it cannot be written ({error})"
            rest = (
                f"the {self.written} frames until then are in it."
                if self.written
                else "nothing is kept; make room, or record elsewhere."
            )
            raise RecorderError(
                f"The recording {self.path} was stopped, since {reason}: {rest}"
            ) from error

    def _append(self, name: str, rows: NDArray[Any]) -> None:
        if len(rows):
            dataset = self._file[name]
            before = len(dataset)
            dataset.resize(before + len(rows), axis=0)
            dataset[before:] = rows

    def _reserve(self, size: int) -> None:
        """Take room for `size` bytes more, and for closing.

        Raises:
            OSError: there is none.
        """
        needed = self._file.id.get_filesize() + 2 * size + _RESERVE_BYTES
        # Where the system cannot take room (macOS), a full disk is met in the middle of a write.
        if needed > self._reserved and hasattr(os, "posix_fallocate"):
            try:
                os.posix_fallocate(self._descriptor, 0, needed + _RESERVE_BYTES)
            except OSError as error:
                if error.errno in _FULL:
                    raise
            self._reserved = needed + _RESERVE_BYTES

    def _flush(self) -> None:
        self._file.flush()
        os.fsync(self._descriptor)

    def _seal(self) -> None:
        tables = {name: self._file[name][()] for name in layout.TABLE_TYPES}
        digest = layout.content_digest(self._header, self._digest.digest(), tables)
        self._file[layout.SHA256][()] = np.bytes_(digest)
        self._file[layout.COMPLETE][()] = 1
        self._flush()

    def _let_go(self) -> None:
        try:
            self._file.close()
        except (OSError, RuntimeError, ValueError) as error:
            # It follows from a failure that was raised already.
            if self._failure is None:
                raise RecorderError(f"Cannot close the recording {self.path} ({error}).") from error

    def _trim(self) -> None:
        """Give back the room that was taken and not used."""
        with self.path.open("r+b") as file:
            head = file.read(_END_OF_FILE.stop)
            file.truncate(int.from_bytes(head[_END_OF_FILE], "little"))
            os.fsync(file.fileno())
