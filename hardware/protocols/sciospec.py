"""The result frames of Sciospec's EIT instruments: complex potentials of 16 channels each.

A message is `[tag][length][payload][tag]`, numbers big-endian. One result frame belongs to one
injection; the frames of all injections of the pattern, in its order, make one frame of ours.
Channels and electrodes are numbered from 1. The current, the frequency and the rate are set by the
maker's program; the first frequency is used, and values are volts (not per ampere).
"""

import re
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Frame
from eitbench.hardware.protocols.protocol import Device, Protocol, Scanner
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import Drives, places
from eitbench.scenarios.sensors.sensor import Sensor

CHANNELS = 16
RESULT_BYTES = 140
ACKNOWLEDGED, REFUSED = b"\x18\x01\x83\x18", b"\x18\x01\x81\x18"
START, STOP = b"\xb4\x01\x01\xb4", b"\xb4\x01\x00\xb4"

_RESULT, _PAYLOAD = 0xB4, RESULT_BYTES - 3
_ROWS = 256  # result frames that are looked at together
_GROUP = 1  # the only one with 16 channels
_SOURCE, _ROW, _TIME, _VALUES = 3, slice(5, 7), slice(7, 11), slice(11, 139)
_HEAD = bytes([_RESULT, _PAYLOAD, _GROUP])
_NONE = -1  # no injection
_STARTS = re.compile(re.escape(_HEAD) + rb"|\x18\x01[\x81-\x83]")


def drives(sensor: Sensor) -> Drives:
    """(src, sink) of every injection of the sensor's pattern, in order."""
    return list(dict.fromkeys((src, sink) for src, sink, _, _ in sensor.pattern.table.tolist()))


def _ends(src: int, sink: int) -> bytes:
    """The electrodes of an injection, as messages number them."""
    return bytes([src + 1, sink + 1])


def _pair(src: int, sink: int) -> bytes:
    """The command that adds an injection."""
    return b"\xb0\x03\x06" + _ends(src, sink) + b"\xb0"


class _SciospecDevice(Device):
    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._drives: Drives = []
        src, sink, a, b = sensor.pattern.table.T
        # Potentials with the least sum of squares whose differences are the values.
        self._inverses = {}
        for drive in drives(sensor):
            rows = np.flatnonzero((src == drive[0]) & (sink == drive[1]))
            differences = np.zeros((len(rows), CHANNELS))
            differences[np.arange(len(rows)), a[rows]] = 1
            differences[np.arange(len(rows)), b[rows]] = -1
            self._inverses[drive] = rows, np.linalg.pinv(differences)

    def obey(self, data: bytes) -> bytes:
        self._rest += data
        answer = b""
        while len(self._rest) > 1:
            end = self._rest[1] + 3
            message, after = self._rest[:end], self._rest[end:]
            if len(message) < end and end < 16:
                break
            if len(message) < end or message[-1] != message[0]:
                self._rest = self._rest[1:]
                continue
            self._rest = after
            answer += ACKNOWLEDGED if self._command(message) else REFUSED
        return answer

    def _command(self, message: bytes) -> bool:
        if message in (START, STOP):
            self.running = message == START
        elif len(message) == 6 and message[:3] == _pair(0, 0)[:3]:
            drive = (message[3] - 1, message[4] - 1)
            if drive not in self._inverses:
                return False
            # As the host may have been started again, a pair is measured once all the same.
            self._drives = [d for d in self._drives if d != drive] + [drive]
        else:
            return False
        return True

    def encode(self, number: int, time_s: float, values: Array) -> bytes:
        stamp = (round(time_s * 1e3) % (1 << 32)).to_bytes(4, "big")
        messages = []
        for src, sink in self._drives:
            rows, inverse = self._inverses[src, sink]
            potentials = np.zeros((CHANNELS, 2), ">f4")
            potentials[:, 0] = inverse @ values[rows]
            head = _HEAD + _ends(src, sink) + b"\0\0" + stamp
            messages.append(head + potentials.tobytes() + bytes([_RESULT]))
        return b"".join(messages)


class Sciospec(Protocol):
    """One frame from the result frames of all injections, in the order of the pattern."""

    name = "sciospec"
    baud = 115_200  # a serial port over USB: any rate is full speed
    default_sensor = "sciospec-tank"
    device = _SciospecDevice
    awaits_answers = True
    waking = (STOP, START)

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._drives = drives(sensor)
        self._places = places(self._drives, sensor.pattern)
        self._order = np.arange(len(self._drives))
        # From src and sink, a byte each, to the number of the injection; -1 is none.
        self._injection = np.full((256, 256), _NONE)
        for k, (src, sink) in enumerate(self._drives):
            self._injection[src + 1, sink + 1] = k
        self._scanner = Scanner(_STARTS, partial(_frame_length, last=_ends(*self._drives[-1])))
        self._set = np.empty((0, RESULT_BYTES), np.uint8)  # of the frame that is being completed
        self._number = 0
        # The injection that was passed over last, on the way to the next frame; None in a frame.
        self._passed: int | None = _NONE

    def begin(self) -> None:
        """See `Protocol`; what comes first may be the end of a frame."""
        super().begin()
        self._set, self._passed = self._set[:0], _NONE

    @classmethod
    def check(cls, sensor: Sensor) -> None:
        """Refuse a sensor with more electrodes than channels."""
        if sensor.n_electrodes > CHANNELS:
            raise InputError(
                f"Sensor {sensor.name!r} has {sensor.n_electrodes} electrodes, and board "
                f"{cls.name!r} {CHANNELS} channels: choose another sensor."
            )

    def starting(self) -> Sequence[bytes]:
        """The injections of the pattern, and the start."""
        return [*(_pair(*drive) for drive in self._drives), START]

    def feed(self, data: bytes, received_s: float) -> list[Frame]:
        """The frames whose last result frame is in `data`."""
        results = [self._set]
        for raw in self._scanner.feed(data):
            if raw[0] == _RESULT:
                results.append(np.frombuffer(raw, np.uint8).reshape(-1, RESULT_BYTES))
            else:
                self.answers.append(raw == ACKNOWLEDGED)
        del self.answers[:-64]
        if len(results) == 1:
            return []
        rows = np.concatenate(results)
        rows = rows[(rows[:, _ROW] == 0).all(axis=1)]
        return self._frames(rows, received_s)

    def _frames(self, rows: NDArray[np.uint8], received_s: float) -> list[Frame]:
        """Frames that result frames `rows` (k, 140) make; the rest waits for more."""
        found = self._injection[rows[:, _SOURCE], rows[:, _SOURCE + 1]]
        if (found < 0).any():
            self._refuse(
                f"The instrument measures injections that are not in the pattern of sensor "
                f"{self.sensor.name!r}: choose the sensor that is on it, or reset its set-up."
            )
        at, n = 0, len(self._drives)
        whole: list[int] = []
        numbers: list[int] = []
        while True:
            if self._passed is not None:
                at = self._next_begin(found, at)
            wanted = self._order[: len(found) - at]
            wrong = np.flatnonzero(found[at : at + n] != wanted)
            if wrong.size:
                self._lose_one()
                at += int(wrong[0])
                self._passed = int(wrong[0]) - 1
            elif len(wanted) < n:
                break
            else:
                whole.append(at)
                numbers.append(self._number)
                self._number += 1
                at += n
        self._set = rows[at:].copy()
        if not whole:
            return []
        sets = rows[np.add.outer(np.array(whole), self._order)]
        return self._measured(sets, numbers, received_s)

    def _next_begin(self, found: NDArray[np.int64], at: int) -> int:
        """The place of the next first injection in `found` (k,), or k; the rest of a lost frame.

        Where the injections begin anew without their first one, another frame is lost.
        """
        assert self._passed is not None
        while at < len(found) and found[at] != 0:
            if 0 <= found[at] < self._passed - len(self._drives) // 2:
                self._lose_one()
            self._passed = int(found[at])
            at += 1
        if at < len(found):
            self._passed = None
        return at

    def _lose_one(self) -> None:
        """Count a damaged frame; it leaves a gap in the numbers."""
        self.health.damaged += 1
        self._number += 1

    def _measured(
        self, sets: NDArray[np.uint8], numbers: list[int], received_s: float
    ) -> list[Frame]:
        """Frames from the result frames (k, injections, 140) of every injection."""
        with np.errstate(invalid="ignore"):  # what is not finite is thrown away as impossible
            pairs = np.ascontiguousarray(sets[..., _VALUES]).view(">f4")
            potentials = pairs[..., 0::2].astype(np.float64)  # the parts in phase
            drive, a, b = self._places
            values = potentials[:, drive, a] - potentials[:, drive, b]
        stamps = np.ascontiguousarray(sets[:, -1, _TIME]).view(">u4")[:, 0] * 1e-3
        frames = []
        for frame, number, stamp in zip(values, numbers, stamps.tolist(), strict=True):
            # Instruments that stamp nothing send 0.
            time_s = stamp or received_s
            frames.append(self._frame(number, time_s, received_s, frame))
        return [frame for frame in frames if frame is not None]

    @classmethod
    def recognises(cls, data: bytes) -> bool:
        """Two result frames behind each other, or the answers to `waking` and what follows."""
        if re.match(rb"(?:\x18\x01[\x81-\x83]\x18){2}(?:\xb4|\Z)", data):
            return True
        result = re.escape(_HEAD[:2]) + rb"[\s\S]{%d}\xb4" % (_PAYLOAD)
        return re.search(rb"(?:" + result + rb"){2}", data) is not None


def _frame_length(buffer: bytearray, at: int, last: bytes) -> int | None:
    """Length of the message at `at`, or of several result frames, which confirm each other.

    A single result frame has no checksum: one that was cut short may end on a tag by chance, inside
    the next or with its first byte. So it counts if a tag follows, else only if none begins inside
    it. Behind it more bytes must come, unless it is of the `last` injection.
    """
    if buffer[at] != _RESULT:
        if at + len(ACKNOWLEDGED) > len(buffer):
            return None
        return len(ACKNOWLEDGED) if buffer[at + 3] == buffer[at] else 0
    count = min((len(buffer) - at) // RESULT_BYTES, _ROWS)
    if count == 0:
        return None
    rows = np.frombuffer(buffer, np.uint8, count * RESULT_BYTES, at).reshape(count, -1)
    good = (rows[:, :3] == np.frombuffer(_HEAD, np.uint8)).all(1) & (rows[:, -1] == _RESULT)
    good &= (rows[:, _SOURCE] != rows[:, _SOURCE + 1]) & (rows[:, _SOURCE] <= CHANNELS)
    length = RESULT_BYTES * (count if good.all() else int(np.argmin(good)))
    if length > RESULT_BYTES:
        return length - RESULT_BYTES  # the last one is tried alone, then
    if length == 0:
        return 0
    end = at + length
    following = bytes(buffer[end : end + 2])
    if not following and buffer[at + _SOURCE : at + _SOURCE + 2] != last:
        return None
    if following in (_HEAD[:2], ACKNOWLEDGED[:2]):
        return length
    inside = buffer.find(_HEAD, at + 1, end + len(_HEAD) - 1)
    while inside >= 0:
        closing = inside + RESULT_BYTES - 1
        if closing >= len(buffer):
            return None
        if buffer[closing] == _RESULT:
            return 0
        inside = buffer.find(_HEAD, inside + 1, end + len(_HEAD) - 1)
    return length
