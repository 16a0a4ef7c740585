"""A board on a serial port, whatever protocol it speaks."""

import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import serial

from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame
from eitbench.hardware.protocols import PROTOCOLS, Protocol
from eitbench.hardware.protocols.eit_kit import EitKit
from eitbench.hardware.protocols.openeit import OpenEit
from eitbench.hardware.protocols.sciospec import Sciospec
from eitbench.hardware.protocols.teensy import Teensy
from eitbench.hardware.serial import ports
from eitbench.hardware.serial.diagnosis import LEAST_BYTES, diagnose
from eitbench.scenarios.sensors.sensor import Sensor

_POLL_S = 0.02  # a read waits no longer, so that `frames` keeps to its time
_CHUNK = 1 << 16  # bytes that are read at once
_REMEMBERED = 1 << 15  # bytes since the last frame that a diagnosis looks at
_DAMAGED = 3  # frames; one or two may have been cut off
_PATIENCE_S = 3.0  # a board that sends no frame for so long, though bytes, is looked at
_SILENCE_S = 5.0  # a board that was started sends something within this time
_LISTEN_S = 0.5  # as long as it is listened to at another rate
_ANSWER_S = 1.0  # a board answers a command within this time
_WRITE_S = 1.0  # a board takes a command within this time


def _errors() -> tuple[type[Exception], ...]:
    try:
        import termios
    except ImportError:  # Windows
        return (OSError,)
    return OSError, termios.error


_GONE = _errors()
"""Of a port that goes while it is set up; pyserial's own errors are OSErrors."""


def _is_pseudo_terminal(port: str) -> bool:
    path = Path(port).resolve()
    # On macOS, /dev/ttys004; ports of devices are named otherwise.
    return path.is_relative_to("/dev/pts") or bool(re.fullmatch(r"/dev/ttys\d+", str(path)))


class SerialBoard(Board):
    """A board that speaks `protocol` on the serial port `port`.

    A wait is up to 20 ms longer than asked for, as this is how long the port is listened to.

    Raises:
        InputError: boards of this kind cannot measure the sensor's pattern.
    """

    protocol: ClassVar[type[Protocol]]
    default_sensor: ClassVar[str]

    def __init_subclass__(cls) -> None:
        if "protocol" in vars(cls):
            cls.baud = cls.protocol.baud
            cls.default_sensor = vars(cls).get("default_sensor", cls.protocol.default_sensor)

    def __init__(self, sensor: Sensor, port: str) -> None:
        # A pseudo-terminal is taken for an emulated board, whatever firmware it reports.
        super().__init__(sensor, emulated=_is_pseudo_terminal(port))
        self.port = port
        self._parser = self.protocol(sensor)
        self._serial: serial.Serial | None = None
        self._started = False
        self._since: float | None = None  # time of the first byte after the last frame
        self._silent_since: float | None = None  # time of the start, until a byte comes
        self._repeated = False  # the start was sent twice
        self._forget()

    def open(self) -> None:
        """Take hold of the port."""
        self.close()
        ports.check(self.port)
        self._parser = self.protocol(self.sensor)
        self.health = self._parser.health
        self._forget()
        try:
            self._serial = serial.Serial(
                self.port,
                self.protocol.baud,
                timeout=_POLL_S,
                write_timeout=_WRITE_S,
                exclusive=True if os.name == "posix" else None,
            )
        except _GONE as error:
            raise ports.refused(self.port, OSError(*error.args)) from error
        try:
            self.firmware = self._ask_firmware()
        except BoardError:
            self.close()
            raise

    def start(self) -> None:
        """Start measuring; a measurement under way is stopped first."""
        for command in self._parser.stopping():
            self._send(command)
            self._answer()
        with self._line() as line:
            line.reset_input_buffer()
        self._parser.begin()
        for command in self._parser.starting():
            self._send(command)
            obeyed = self._answer()
            if obeyed is False:
                raise BoardError(
                    f"The board on {self.port} refuses the command {command.hex(' ')}: see whether "
                    f"its set-up fits sensor {self.sensor.name!r}."
                )
            if obeyed is None and self._parser.awaits_answers:
                raise BoardError(
                    self._diagnosis()
                    or self._other_board()
                    or f"The board on {self.port} does not answer as {self.protocol.name!r} does: "
                    "see whether it is switched on, and whether this is its port."
                )
        self._started = True
        self._repeated = False
        self._silent_since = time.monotonic()

    def frames(self, wait_s: float) -> list[Frame]:
        """Return the frames that have arrived since the last call."""
        end = time.monotonic() + wait_s
        while True:
            data = self._read()
            if self._started:  # some boards send all the time
                frames = self._parser.feed(data, time.monotonic())
                if frames:
                    self._forget()
                    self._silent_since = time.monotonic()
                    return frames
                self._check_progress(data)
            if time.monotonic() >= end:
                return []

    def stop(self) -> None:
        """Pause; bytes that it sends nevertheless are not read."""
        for command in self._parser.stopping():
            self._send(command)
        self._started = False

    def close(self) -> None:
        """Let go of the port."""
        self._started = False
        if self._serial is not None:
            self._serial.close()
            self._serial = None

    @contextmanager
    def _line(self) -> Iterator[serial.Serial]:
        """The open port; it is let go of if the board is gone."""
        if self._serial is None:
            raise BoardError(f"The board on {self.port} is not open: open it first.")
        try:
            yield self._serial
        except serial.SerialTimeoutException as error:
            raise BoardError(
                f"The board on {self.port} takes no commands: see whether it is the right port, "
                "and switch the board off and on."
            ) from error
        except _GONE as error:
            self.close()
            raise BoardLostError(
                f"The board on {self.port} is gone: it was unplugged or lost its power; plug it in "
                "and start again."
            ) from error

    def _ask_firmware(self) -> str:
        """Return the name and version of the firmware; "" if the board does not answer."""
        if self.protocol.question is None:
            return ""
        command, answer = self.protocol.question
        self._send(command)
        heard, end = b"", time.monotonic() + _ANSWER_S
        while time.monotonic() < end:
            heard += self._read()
            if found := answer.search(heard):
                return found[1].decode()
        return ""

    def _read(self) -> bytes:
        """Return the bytes that have arrived, at most `_CHUNK`; wait a little if there are none."""
        with self._line() as line:
            return bytes(line.read(min(max(line.in_waiting, 1), _CHUNK)))

    def _send(self, command: bytes) -> None:
        self._parser.answers.clear()
        with self._line() as line:
            line.write(command)

    def _answer(self) -> bool | None:
        """True if the board obeyed the last command, False if not; None without an answer."""
        end = time.monotonic() + _ANSWER_S
        while self._parser.awaits_answers and time.monotonic() < end:
            data = self._read()
            self._parser.feed(data, time.monotonic())
            self._check_progress(data)
            if self._parser.answers:
                return self._parser.answers.pop(0)
        return None

    def _forget(self) -> None:
        """Forget the bytes since the last frame: one has come, or none is expected."""
        self._unread = bytearray()
        self._since = self._silent_since = None

    def _check_progress(self, data: bytes) -> None:
        """Find the reason if no frame comes for too long; `data` are the latest bytes."""
        now = time.monotonic()
        silent = not data and now - (self._silent_since or now) > _SILENCE_S
        if (silent or self._parser.refusal) and self._start_again():
            return
        if self._parser.refusal:
            raise BoardError(self._parser.refusal)
        if silent and self.health.frames:
            raise BoardError(
                f"The board on {self.port} has stopped sending: look at its cable and power, and "
                "start again."
            )
        if silent:
            raise BoardError(
                self._other_board()
                or f"The board on {self.port} sends nothing: see whether it is switched on, is a "
                f"board {self.protocol.name!r}, and is set to {self.protocol.baud} bit/s."
            )
        if not data:
            return
        self._silent_since = now
        self._since = self._since or now
        self._unread += data
        del self._unread[:-_REMEMBERED]
        if now - self._since > _PATIENCE_S:
            if wrong := self._diagnosis():
                raise BoardError(wrong)
            if len(self._unread) >= LEAST_BYTES:
                self._forget()
            self._silent_since = now

    def _start_again(self) -> bool:
        """Send the start again, once: opening the port resets many boards, which then miss it."""
        if self._repeated or self._parser.awaits_answers:
            return False
        for command in self._parser.starting():
            self._send(command)
        self._repeated = True
        self._parser.refusal = None
        self._silent_since = time.monotonic()
        return True

    def _diagnosis(self) -> str | None:
        heard = bytes(self._unread)
        whole, damaged = self.health.frames, self.health.damaged
        if not whole and damaged >= _DAMAGED and self.protocol.recognises(heard):
            return (
                f"Frames of board {self.protocol.name!r} come from {self.port}, and all are "
                "damaged: its firmware makes another checksum, or sends another number of values "
                "than it says (docs/boards.md names the format)."
            )
        return diagnose(heard, self.protocol, self.port, self._listen)

    def _other_board(self) -> str | None:
        """Name the other board that it is, if that one is silent until started; one sentence."""
        # The last one first: `sciospec` would take the text of `teensy` for half a message.
        for name, protocol in reversed(PROTOCOLS.items()):
            if not protocol.waking or name == self.protocol.name:
                continue
            heard = self._listen(protocol.baud, protocol.waking)
            self._listen(protocol.baud, protocol.waking[:1])  # whatever it is, it stops
            if protocol.recognises(heard):
                return (
                    f"What {self.port} answers looks like board {name!r}, not "
                    f"{self.protocol.name!r}: give --board {name}."
                )
        return None

    def _listen(self, baud: int, commands: Sequence[bytes] = ()) -> bytes:
        """Return the bytes that come at another rate, after `commands`."""
        with self._line() as line:
            line.baudrate = baud
            line.reset_input_buffer()
            for command in commands:
                self._send(command)
            heard = bytearray()
            end = time.monotonic() + _LISTEN_S
            while time.monotonic() < end:
                heard += self._read()
            line.baudrate = self.protocol.baud
        return bytes(heard)


class TeensyBoard(SerialBoard):
    """A Teensy 4.1 class board that sends binary frames with checksum."""

    protocol = Teensy


class EitKitBoard(SerialBoard):
    """A board derived from EIT-kit, which sends matrices as text."""

    protocol = EitKit


class OpenEitBoard(SerialBoard):
    """An OpenEIT board, which sends magnitudes of an opposition pattern as text."""

    protocol = OpenEit


class SciospecBoard(SerialBoard):
    """An EIT instrument of Sciospec, which sends complex potentials of 16 channels."""

    protocol = Sciospec


SERIAL_BOARDS: dict[str, type[SerialBoard]] = {
    board.protocol.name: board for board in (TeensyBoard, EitKitBoard, OpenEitBoard, SciospecBoard)
}
"""Every board on a serial port by name."""
