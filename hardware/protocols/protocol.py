"""Interface of a protocol: the host's end, and the board's end for the emulator.

Nothing here reads or writes a port: bytes come in and go out as values, so that every protocol can
be tested with any bytes, and the emulator speaks exactly what the reader understands.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from eitbench.hardware.board import Frame, Health
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.recordings.frames import impossible, peak
from eitbench.scenarios.sensors.sensor import Sensor

# So many frames in a row that are not the sensor's are no accident; fewer may still be under way
# from before the board was set up.
PATIENCE = 5


class Protocol(ABC):
    """The host's end: bytes of a board in, frames out; any bytes are accepted.

    Attributes:
        name: registry name, also of the board that speaks it.
        baud: rate of the line [bit/s].
        default_sensor: registry name of the sensor that boards of this kind measure.
        device: the board's end.
        question: the command that asks for the firmware, and the pattern of the answer; None
            without such a command.
        answers: answers of the board to commands (see `awaits_answers`), oldest first: True if it
            acknowledged, False if it refused. The host removes them.
        awaits_answers: the board answers every command.
        waking: the commands that stop and start any board of this kind, whatever its sensor; none
            where they send by themselves.
        sensor: the nominal sensor; its drive pattern gives the order of a frame's values.
        health: counts of frames and of bytes that belong to none.
        refusal: sentence on why the bytes cannot be frames of the sensor; None if they can.

    Raises:
        InputError: boards of this kind cannot measure the sensor's pattern.
    """

    name: ClassVar[str]
    baud: ClassVar[int]
    default_sensor: ClassVar[str] = "foam16"
    device: ClassVar["type[Device]"]
    awaits_answers: ClassVar[bool] = False
    waking: ClassVar[tuple[bytes, ...]] = ()
    question: ClassVar[tuple[bytes, re.Pattern[bytes]] | None] = None

    def __init__(self, sensor: Sensor) -> None:
        self.check(sensor)
        self.sensor = sensor
        self.health = Health()
        self.refusal: str | None = None
        self.answers: list[bool] = []
        self._refused = self._impossible = 0
        self._last_number: int | None = None  # of the last frame, where the board counts them

    @classmethod
    @abstractmethod
    def check(cls, sensor: Sensor) -> None:
        """Refuse a sensor with a pattern that boards of this kind cannot measure.

        Raises:
            InputError: it cannot be measured.
        """

    def starting(self) -> Sequence[bytes]:
        """The commands that have the board measure."""
        return self.waking[1:]

    def stopping(self) -> Sequence[bytes]:
        """The commands that have it pause."""
        return self.waking[:1]

    def begin(self) -> None:
        """Begin a new series of frames: the board was paused meanwhile.

        Frames that it sent before it paused are not counted as lost.
        """
        self._last_number = None

    @abstractmethod
    def feed(self, data: bytes, received_s: float) -> list[Frame]:
        """Return the frames that `data` completes, oldest first.

        Args:
            data: the next bytes of the stream.
            received_s: when they were read [s].
        """

    @classmethod
    @abstractmethod
    def recognises(cls, data: bytes) -> bool:
        """True if the stream `data` of an unknown board is of this protocol."""

    def _frame(self, number: int, time_s: float, received_s: float, values: Array) -> Frame | None:
        """A whole frame, counted; None if its values are impossible."""
        if impossible(values[None]).size:
            self._impossible += 1
            self.health.damaged += 1
            self._refuse(
                f"The board sends impossible values, such as {peak(values)}: see whether its "
                "firmware, its pattern and its wiring are those of the sensor."
            )
            return None
        self.health.frames += 1
        self._refused = 0
        self.refusal = None
        if self.sensor.pattern.magnitudes:
            values = np.abs(values)
        return Frame(number, time_s, received_s, values)

    def _refuse(self, sentence: str) -> None:
        """Count a whole frame that is not one of the sensor's."""
        self._refused += 1
        if self._refused % PATIENCE == 0:
            self.refusal = sentence


class Device(ABC):
    """The board's end, for the emulator.

    Attributes:
        sensor: what it measures.
        running: True while it sends frames.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.running = False
        self._rest = b""

    @abstractmethod
    def obey(self, data: bytes) -> bytes:
        """Obey the commands in `data`, and return the answer."""

    @abstractmethod
    def encode(self, number: int, time_s: float, values: Array) -> bytes:
        """Encode a frame.

        Args:
            number: running number.
            time_s: the board's clock [s].
            values: (M,) [V/A] in the order of the sensor's pattern.
        """

    def _lines(self, data: bytes) -> list[bytes]:
        """The lines that `data` completes, stripped; an endless one is forgotten."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-64:]
        return [line.strip() for line in whole]


FrameMatcher = Callable[[bytearray, int], int | None]
"""Length of the frame at a place in the buffer; 0 if there is none, None if more bytes decide."""

_CHUNK = 1 << 16  # a large feed costs no more than many small ones


class Scanner:
    """A scanner that cuts frames out of a stream; a false start hides no frame behind it.

    A frame may begin wherever `start` matches (at most 4 bytes), and `match` decides whether it
    does. The longest frame bounds the size of the buffer. While a place is undecided, later places
    are tried nevertheless, so that neither a frame that was cut short nor a false length makes a
    good frame wait. Behind a place without a frame the search goes on one byte further, never
    behind the length that was claimed there.

    Attributes:
        false_starts: places so far that looked like the start of a frame and were none.
    """

    def __init__(self, start: re.Pattern[bytes], match: FrameMatcher) -> None:
        self._start = start
        self._match = match
        self._buffer = bytearray()
        self.false_starts = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the frames that `data` completes."""
        frames = []
        for begin in range(0, len(data), _CHUNK):
            self._buffer += data[begin : begin + _CHUNK]
            frames += self._scan()
        return frames

    def _scan(self) -> list[bytes]:
        buffer, frames = self._buffer, []
        settled = at = 0
        undecided: int | None = None
        while found := self._start.search(buffer, at):
            at = found.start()
            length = self._match(buffer, at)
            if length is None and undecided is None:
                undecided = at
            if not length:
                at += 1
                continue
            self._count_false_starts(settled, at)
            frames.append(bytes(memoryview(buffer)[at : at + length]))
            settled = at = at + length
            undecided = None
        if undecided is None:
            # A frame may begin in the last bytes without being seen yet.
            undecided = max(settled, len(buffer) - 3)
        self._count_false_starts(settled, undecided)
        del buffer[:undecided]
        return frames

    def _count_false_starts(self, begin: int, end: int) -> None:
        if end > begin:
            self.false_starts += len(self._start.findall(self._buffer, begin, end))
