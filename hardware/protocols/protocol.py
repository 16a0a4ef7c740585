"""What a protocol is: what a host says and hears, and what a board does at the other end.

Nothing here reads or writes a port: bytes come in and go out as values, so that every protocol can
be tested with any bytes, and the emulator speaks exactly what the reader understands.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Frame, Health
from eitbench.scenarios.sensors.sensor import Sensor

Array = NDArray[np.float64]

# So many frames in a row of another kind than the sensor's, and none of its own, are no accident;
# fewer may still be under way from before a board was told what to measure.
PATIENCE = 5


class Protocol(ABC):
    """The host's end: bytes of a board in, frames out, whatever the bytes.

    Attributes:
        name: registry name, also of the board that speaks it.
        baud: rate of the line [bit/s].
        default_sensor: registry name of the sensor that boards of this kind measure.
        device: the board's end.
        question: the command that the board answers with a line on its firmware, and that line;
            none where there is no such command.
        answers: what the board has answered to commands, by acknowledging or refusing (see
            `awaits_answers`): whether it obeyed, oldest first, for the host to take away.
        awaits_answers: the board answers every command.
        waking: the commands that stop and start any board of this kind, whatever its sensor; none
            where they send by themselves.
        sensor: the nominal sensor; its drive pattern gives the order of a frame's values.
        health: what came of the bytes.
        refusal: why what arrives cannot be frames of the sensor, as one sentence; None if it can.

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
        self._refused = 0
        self._last_number: int | None = None  # of the last frame, where the board counts them

    @classmethod
    @abstractmethod
    def check(cls, sensor: Sensor) -> None:
        """Refuse a sensor whose pattern boards of this kind cannot measure.

        Raises:
            InputError: it cannot be measured.
        """

    def starting(self) -> Sequence[bytes]:
        """The commands that have the board measure."""
        return ()

    def stopping(self) -> Sequence[bytes]:
        """The commands that have it pause."""
        return ()

    def begin(self) -> None:
        """What comes next does not continue what came before: a board was paused meanwhile.

        What it sent before it heard of that is not counted as lost.
        """
        self._last_number = None

    @abstractmethod
    def feed(self, data: bytes, received_s: float) -> list[Frame]:
        """The frames that `data` completes, oldest first.

        Args:
            data: the next bytes of the stream.
            received_s: when they were read [s].
        """

    @classmethod
    @abstractmethod
    def recognises(cls, data: bytes) -> bool:
        """Whether the stream `data` of an unknown board is of this protocol."""

    def _frame(self, number: int, time_s: float, received_s: float, values: Array) -> Frame:
        """A whole frame, counted."""
        self.health.frames += 1
        self._refused = 0
        self.refusal = None
        if self.sensor.pattern.magnitudes:
            values = np.abs(values)
        return Frame(number, time_s, received_s, values)

    def _refuse(self, sentence: str) -> None:
        """Count a whole frame that is none of the sensor's."""
        self._refused += 1
        if self._refused % PATIENCE == 0:
            self.refusal = sentence


class Device(ABC):
    """The board's end, for the emulator.

    Attributes:
        sensor: what it measures.
        running: whether it sends frames.
    """

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.running = False

    @abstractmethod
    def obey(self, data: bytes) -> bytes:
        """Do what the host says with `data`, and return the answer."""

    @abstractmethod
    def encode(self, number: int, time_s: float, values: Array) -> bytes:
        """The bytes of a frame.

        Args:
            number: running number.
            time_s: the board's clock [s].
            values: (M,) [V/A] in the order of the sensor's pattern.
        """


class Commands:
    """Commands of a host, cut out of its stream of bytes; a piece without an end is forgotten."""

    def __init__(self, longest: int = 64) -> None:
        self._longest = longest
        self._rest = b""

    def lines(self, data: bytes) -> list[bytes]:
        """The lines that `data` completes, without white space around them."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-self._longest :]
        return [line.strip() for line in whole]
