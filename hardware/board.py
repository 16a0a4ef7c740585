"""What a board is: a source of frames that is opened, started, stopped and closed."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.sensors.sensor import Sensor


class BoardError(EitbenchError):
    """A board cannot be used; the sentence says why and what to do."""


class BoardLostError(BoardError):
    """The board went away while it was in use: unplugged, or without power."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame, as a board measured it.

    Attributes:
        number: the board's running number, or ours where it sends none; a gap is a lost frame.
        time_s: when it was measured [s]: the board's clock, or ours where it sends none.
        received_s: when its last byte was read [s], on this machine's monotonic clock.
        values: (M,) in the order of the sensor's drive pattern, in the board's units.
    """

    number: int
    time_s: float
    received_s: float
    values: NDArray[np.float64]


@dataclass
class Health:
    """What came of the bytes a board has sent since it was opened.

    Attributes:
        frames: whole frames.
        dropped: frames that its running numbers show to be missing.
        damaged: frames with a wrong checksum, or cut short.
        skipped_bytes: bytes that belong to no frame.
    """

    frames: int = 0
    dropped: int = 0
    damaged: int = 0
    skipped_bytes: int = 0


class Board(ABC):
    """A board; the first line of a subclass's docstring is its description.

    Attributes:
        default_sensor: registry name of the sensor it measures if the user names none.
        sensor: the nominal sensor on it; its drive pattern gives the order of a frame's values.
        health: what came of its bytes.
        firmware: what it says of itself, known once it is open; "" if it says nothing.
    """

    default_sensor: ClassVar[str] = "foam16"

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.health = Health()
        self.firmware = ""

    @abstractmethod
    def open(self) -> None:
        """Take hold of it.

        Raises:
            BoardError: there is none, it may not be used, or another program has it.
        """

    @abstractmethod
    def start(self) -> None:
        """Have it measure."""

    @abstractmethod
    def frames(self, wait_s: float) -> list[Frame]:
        """The frames that have arrived since the last call, oldest first.

        Returns at once if there are any, else waits for the first at most `wait_s` [s].

        Raises:
            BoardLostError: it was unplugged.
            BoardError: what it sends cannot be its frames: another board's protocol, a wrong baud
                rate, or a number of values that the sensor's pattern does not have.
        """

    @abstractmethod
    def stop(self) -> None:
        """Have it pause; it may be started again."""

    @abstractmethod
    def close(self) -> None:
        """Let go of it; no error if it was lost or never opened."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
