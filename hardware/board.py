"""Interface of a board: a source of frames that is opened, started, stopped and closed."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.sensors.sensor import Sensor


class BoardError(EitbenchError):
    """A board that cannot be used; the sentence says why and what to do."""


class BoardLostError(BoardError):
    """A board that is not there, or went away: unplugged, or without power."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as a board measured it.

    Attributes:
        number: running number of the board, or of its reader if the board sends none; a gap is a
            lost frame.
        time_s: time of the measurement [s] on the board's clock, or on this machine's if the board
            sends none.
        received_s: time at which its last byte was read [s], on this machine's monotonic clock.
        values: (M,) in the order of the sensor's drive pattern, in the board's units.
    """

    number: int
    time_s: float
    received_s: float
    values: NDArray[np.float64]


@dataclass
class Health:
    """Counts of what a board has sent since it was opened.

    Attributes:
        frames: whole frames.
        dropped: frames that its running numbers show to be missing.
        damaged: frames with a wrong checksum, or cut short.
    """

    frames: int = 0
    dropped: int = 0
    damaged: int = 0


class Board(ABC):
    """A source of frames; the first line of a subclass's docstring is its description.

    Attributes:
        default_sensor: registry name of the sensor it measures if the user names none; None if it
            knows its sensor.
        options: what `registry.make_board` takes to make it, beside a sensor.
        baud: rate of its serial line [bit/s]; None without one.
        can_be_pressed: `press` and `release` act on its sensor.
        sensor: the nominal sensor on it; its drive pattern gives the order of a frame's values.
        emulated: no real sensor is measured.
        health: counts of what it has sent.
        firmware: name and version of its firmware, known once it is open; "" if it gives none.
    """

    default_sensor: ClassVar[str | None] = "foam16"
    options: ClassVar[frozenset[str]] = frozenset({"port"})
    baud: ClassVar[int | None] = None
    can_be_pressed: ClassVar[bool] = False

    def __init__(self, sensor: Sensor, *, emulated: bool = False) -> None:
        self.sensor = sensor
        self.emulated = emulated
        self.health = Health()
        self.firmware = ""

    @property
    def ended(self) -> bool:
        """True if no more frames will come."""
        return False

    def press(self, x_m: float, y_m: float, radius_m: float, pressure_pa: float) -> None:
        """Press its sensor with a disc at (x, y) [m] of the sensor's frame, until `release`.

        Raises:
            BoardError: this board's sensor is pressed by a real hand only.
        """
        raise BoardError("Only an emulated sensor can be pressed by a program.")

    def release(self) -> None:  # noqa: B027, nothing to do where nothing can be pressed
        """End the press; no error without one."""

    @abstractmethod
    def open(self) -> None:
        """Take hold of the board.

        Raises:
            BoardError: it does not exist, may not be used, or is in use by another program.
        """

    @abstractmethod
    def start(self) -> None:
        """Start measuring."""

    @abstractmethod
    def frames(self, wait_s: float) -> list[Frame]:
        """Return the frames that have arrived since the last call, oldest first.

        Returns at once if there are any, else waits for the first at most `wait_s` [s].

        Raises:
            BoardLostError: it was unplugged.
            BoardError: its bytes cannot be frames of the sensor: another board's protocol, a wrong
                baud rate, or another number of values than the sensor's pattern has.
        """

    @abstractmethod
    def stop(self) -> None:
        """Pause; it may be started again."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the board; no error if it was lost or never opened."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
