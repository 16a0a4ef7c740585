"""Protocols of lines of text: one line is a frame or free text."""

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Frame
from eitbench.hardware.protocols.protocol import Protocol
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.compiling import compiled
from eitbench.scenarios.sensors.sensor import Sensor

LONGEST = 1 << 16  # more than any line with a frame; of a longer one its end is looked at
NUMBERS = b"0123456789+-., \t"


class LineProtocol(Protocol):
    """Frames in lines that end with a line feed; without checksum and numbers of their own."""

    def __init__(self, sensor: Sensor) -> None:
        super().__init__(sensor)
        self._rest = bytearray()
        numbers(b"0")  # loads compiled code, which no frame is to wait for

    def feed(self, data: bytes, received_s: float) -> list[Frame]:
        """The frames in the lines that `data` completes."""
        self._rest += data
        frames = []
        if b"\n" in data:
            *lines, self._rest = self._rest.split(b"\n")
            for line in lines:
                values = self._values(bytes(line[-LONGEST:]).rstrip(b"\r"))
                if values is not None:
                    # They send no numbers; a damaged one leaves a gap in ours.
                    number = self.health.frames + self.health.damaged
                    frames.append(self._frame(number, received_s, received_s, values))
        if len(self._rest) > LONGEST:
            del self._rest[:-LONGEST]
        return [frame for frame in frames if frame is not None]

    @abstractmethod
    def _values(self, line: bytes) -> Array | None:
        """The values (M,) of a whole `line`; None if it has none."""


def numbers(text: bytes) -> Array:
    """The numbers between the commas of `text`, decimals without exponent; none if it holds more.

    White space may stand around them, and a comma behind the last.
    """
    values = np.empty(text.count(b",") + 1)
    return values[: _read(np.frombuffer(text, np.uint8), values)]


@compiled
def _read(text: NDArray[np.uint8], values: Array) -> int:
    """Write the numbers of `text` to `values`; their count, or 0 where it is malformed."""
    count = mantissa = digits = decimals = 0
    sign = 0.0  # 0 before the sign or the first digit
    point = ended = False
    for k in range(len(text) + 1):
        letter = text[k] if k < len(text) else 44
        if 48 <= letter <= 57 and not ended:
            mantissa = 10 * mantissa + int(letter) - 48
            digits += 1
            decimals += point
            sign = sign or 1.0
            if digits > 15:  # more than a float64 holds for certain
                return 0
        elif letter == 46 and not point and not ended:  # .
            point = True
            sign = sign or 1.0
        elif (letter == 45 or letter == 43) and sign == 0:  # - +
            sign = -1.0 if letter == 45 else 1.0
        elif letter == 32 or letter == 9:
            ended = sign != 0
        elif letter == 44:  # ,
            if digits == 0:
                # Nothing may follow the last comma but white space.
                return count if k == len(text) and sign == 0 else 0
            # Both are exact, so that the quotient is the nearest float64.
            values[count] = sign * (mantissa / 10.0**decimals)
            count += 1
            mantissa = digits = decimals = 0
            sign = 0.0
            point = ended = False
        else:
            return 0
    return count
