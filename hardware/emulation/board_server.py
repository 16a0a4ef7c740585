"""The board's end of a pseudo-terminal: sends frames on a fixed grid of time, obeys its host."""

import contextlib
import os
import select
import threading
import time
from collections.abc import Callable

from eitbench.hardware.board import BoardError
from eitbench.hardware.protocols import Protocol
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.sensor import Sensor

Measure = Callable[[float], Array]

_WAKE_S = 0.05  # a thread that is to end notices it within this time
_ANSWERS = 4096  # bytes that wait for a host; of one that does not read nothing more is answered


class BoardServer:
    """A board of `protocol` on a pseudo-terminal, which any program can open as a serial port.

    The k-th frame is measured `k / rate_hz` after the board was switched on, or not at all where
    the machine is late. While no program has the port open, nothing is measured. A program that
    has it open and does not read makes the board drop frames, as its numbers show.

    Attributes:
        port: the device to open, such as "/dev/pts/7".
        rate_hz: frames per second.

    Raises:
        BoardError: this system has no pseudo-terminals.
    """

    def __init__(
        self, protocol: type[Protocol], sensor: Sensor, measure: Measure, rate_hz: float
    ) -> None:
        self._device = protocol.device(sensor)
        self._measure = measure
        self.rate_hz = rate_hz
        self._number = 0
        self._unsent = b""
        self._off = threading.Event()
        try:
            import pty  # not on Windows
            import tty
        except ImportError as error:
            raise BoardError(
                "An emulated board needs a pseudo-terminal, which this system has not: use "
                "--board replay."
            ) from error
        self._master, slave = pty.openpty()
        self.port = os.ttyname(slave)
        # Nothing is echoed, and bytes pass as they are, even before a program opens the port. It is
        # closed here, so that the last program to close it is noticed.
        tty.setraw(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._thread = threading.Thread(target=self._serve, name=f"board {self.port}", daemon=True)

    def start(self) -> None:
        """Switch it on."""
        self._thread.start()

    def stop(self) -> None:
        """Switch it off; the device disappears."""
        self._off.set()
        self._thread.join()

    def wait(self) -> None:
        """Return when it is switched off."""
        self._thread.join()

    def _serve(self) -> None:
        begin, tick = time.monotonic(), 0
        try:
            while not self._off.is_set():
                due = begin + tick / self.rate_hz
                self._attend(due)
                if time.monotonic() < due:
                    continue
                if self._listened() and self._device.running:
                    self._send(tick / self.rate_hz)
                # Frames that could not be measured in time are left out; the grid stays.
                tick = max(tick + 1, int((time.monotonic() - begin) * self.rate_hz))
        finally:
            os.close(self._master)

    def _listened(self) -> bool:
        """True while a program has the port open."""
        return not self._poll(0) & select.POLLHUP

    def _poll(self, wait_s: float) -> int:
        poll = select.poll()
        poll.register(self._master, select.POLLIN | (select.POLLOUT if self._unsent else 0))
        events = poll.poll(wait_s * 1e3)
        return events[0][1] if events else 0

    def _attend(self, until_s: float) -> None:
        """Obey the host until `until_s` on the monotonic clock, but no longer than a moment."""
        wait_s = min(max(until_s - time.monotonic(), 0), _WAKE_S)
        events = self._poll(wait_s)
        if events & select.POLLHUP:
            self._unsent = b""
            self._off.wait(wait_s)
            return
        if events & select.POLLIN:
            with contextlib.suppress(OSError):
                answer = self._device.obey(os.read(self._master, 4096))
                if len(self._unsent) < _ANSWERS:
                    self._write(answer)
        elif events & select.POLLOUT:
            self._write(b"")

    def _send(self, time_s: float) -> None:
        frame = self._device.encode(self._number, time_s, self._measure(time_s))
        self._number += 1
        if not self._unsent:
            self._write(frame)

    def _write(self, data: bytes) -> None:
        """Send what is left of the last frame, and then `data`, as far as there is room."""
        self._unsent += data
        with contextlib.suppress(OSError):
            self._unsent = self._unsent[os.write(self._master, self._unsent) :]
