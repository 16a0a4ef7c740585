"""Protocols of lines of text: one line is a frame or free text."""

import re
from abc import abstractmethod

import numpy as np

from eitbench.hardware.board import Frame
from eitbench.hardware.protocols.protocol import Protocol
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.sensor import Sensor

LONGEST = 1 << 16  # more than any line with a frame; of a longer one its end is looked at
NUMBERS = b"0123456789+-., \t"


class LineProtocol(Protocol):
    """Frames in lines that end with a line feed; without checksum and numbers of their own."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._rest = bytearray()

    def feed(self, data: bytes, received_s: float) -> list[Frame]:
        """The frames in the lines that `data` completes."""
        self._rest += data
        frames = []
        if b"\n" in data:
            *lines, self._rest = self._rest.split(b"\n")
            for line in lines:
                values = self._values(bytes(line[-LONGEST:]).rstrip(b"\r"))
                if values is None:
                    self.health.skipped_bytes += len(line) + 1
                else:
                    # They send no numbers; a damaged one leaves a gap in ours.
                    number = self.health.frames + self.health.damaged
                    frames.append(self._frame(number, received_s, received_s, values))
        if len(self._rest) > LONGEST:
            self.health.skipped_bytes += len(self._rest) - LONGEST
            del self._rest[:-LONGEST]
        return frames

    @abstractmethod
    def _values(self, line: bytes) -> Array | None:
        """The values (M,) of a whole `line`; None if it has none, which is counted."""


_NUMBER = rb"[ \t]*[+-]?(?:\d{1,15}(?:\.\d{0,15})?|\.\d{1,15})[ \t]*"
_NUMBERS = re.compile(rb"%b(?:,%b)*(?:,[ \t]*)?" % (_NUMBER, _NUMBER))


def numbers(text: bytes) -> Array:
    """The numbers between the commas of `text`, decimals without exponent; none if it holds more.

    White space may stand around them, and a comma behind the last.
    """
    if not _NUMBERS.fullmatch(text):
        return np.empty(0)
    return np.array([float(number) for number in text.rstrip(b", \t").split(b",")])
