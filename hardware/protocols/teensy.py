"""Our framed binary protocol for a Teensy 4.1 class board; see docs/teensy-protocol.md."""

import re
import struct
import zlib

import numpy as np

from eitbench.hardware.board import Frame
from eitbench.hardware.protocols.protocol import Device, Protocol, Scanner
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Sensor

SYNC = b"\xa5EIT"
VERSION = 1
MAX_VALUES = 4096
START, STOP, ASK = b"start\n", b"stop\n", b"version\n"
FIRMWARE = b"eitbench-teensy 1.0"

# Sync, version, pattern id, frame number, number of values, time stamp [us].
_HEADER = struct.Struct("<4sHHIIQ")
_CRC = struct.Struct("<I")
_NUMBERS = 1 << 32


def pattern_id(pattern: DrivePattern) -> int:
    """16 bits that tell one drive pattern from another.

    The lower half of the CRC-32 of the table's rows src, sink, a, b, a byte for each number.
    """
    return zlib.crc32(pattern.table.astype(np.uint8).tobytes()) & 0xFFFF


def encode(pattern: int, number: int, time_s: float, values: Array) -> bytes:
    """The bytes of one frame; `values` (M,) [V/A]."""
    header = _HEADER.pack(
        SYNC, VERSION, pattern, number % _NUMBERS, len(values), round(time_s * 1e6)
    )
    body = header + values.astype("<f4").tobytes()
    return body + _CRC.pack(zlib.crc32(body))


class _TeensyDevice(Device):
    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._pattern = pattern_id(sensor.pattern)

    def obey(self, data: bytes) -> bytes:
        answer = b""
        for line in self._lines(data):
            if line in (START.strip(), STOP.strip()):
                self.running = line == START.strip()
            elif line == ASK.strip():
                answer += FIRMWARE + b"\n"
        return answer

    def encode(self, number: int, time_s: float, values: Array) -> bytes:
        return encode(self._pattern, number, time_s, values)


class Teensy(Protocol):
    """Frames with running number, time stamp, pattern id and CRC-32; values are V/A as float32."""

    name = "teensy"
    baud = 2_000_000  # on a serial line; over USB any rate is full speed
    device = _TeensyDevice
    waking = (STOP, START)
    question = (ASK, re.compile(rb"(eitbench-teensy [ -~]{1,40})\r?\n"))

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._pattern = pattern_id(sensor.pattern)
        self._scanner = Scanner(re.compile(re.escape(SYNC)), _frame_length)

    @classmethod
    def check(cls, sensor: Sensor) -> None:
        """Refuse a sensor with more values than a frame can have."""
        if sensor.n_measurements > MAX_VALUES:
            raise InputError(
                f"Board {cls.name!r} sends at most {MAX_VALUES} values a frame, and sensor "
                f"{sensor.name!r} has {sensor.n_measurements}: choose another sensor."
            )

    def feed(self, data: bytes, received_s: float) -> list[Frame]:
        """The frames that `data` completes."""
        decoded = [self._decode(raw, received_s) for raw in self._scanner.feed(data)]
        self.health.damaged = self._scanner.false_starts + self._impossible
        return [frame for frame in decoded if frame is not None]

    def _decode(self, raw: bytes, received_s: float) -> Frame | None:
        _, _, pattern, number, count, time_us = _HEADER.unpack_from(raw)
        m = self.sensor.n_measurements
        if (count, pattern) != (m, self._pattern):
            self._refuse(
                f"The board sends {count} values a frame of drive pattern {pattern:#06x} where "
                f"sensor {self.sensor.name!r} has {m} of {self._pattern:#06x}: choose the sensor "
                "that is on it, or load its pattern into the board."
            )
            return None
        with np.errstate(invalid="ignore"):
            values = np.frombuffer(raw, "<f4", count, _HEADER.size).astype(np.float64)
        # A board that was switched on again counts from 0, which is no loss.
        if self._last_number is not None and number > self._last_number:
            self.health.dropped += number - self._last_number - 1
        self._last_number = number
        return self._frame(number, time_us * 1e-6, received_s, values)

    @classmethod
    def recognises(cls, data: bytes) -> bool:
        """Two headers of version 1."""
        return len(re.findall(re.escape(SYNC + struct.pack("<H", VERSION)), data)) >= 2


def _frame_length(buffer: bytearray, at: int) -> int | None:
    """Length of the frame at `at`; 0 if there is none, None if more bytes must decide."""
    if at + _HEADER.size > len(buffer):
        return None
    _, version, _, _, count, _ = _HEADER.unpack_from(buffer, at)
    if version != VERSION or not 0 < count <= MAX_VALUES:
        return 0
    end: int = at + _HEADER.size + 4 * count
    if end + _CRC.size > len(buffer):
        return None
    (crc,) = _CRC.unpack_from(buffer, end)
    with memoryview(buffer) as view, view[at:end] as body:
        return end + _CRC.size - at if crc == zlib.crc32(body) else 0
