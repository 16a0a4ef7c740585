"""The board's end of a pseudo-terminal: sends frames on a fixed grid of time, obeys its host."""

import contextlib
import os
import pty
import select
import termios
import threading
import time
import tty
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.protocols import Protocol
from eitbench.scenarios.sensors.sensor import Sensor

_BITS = 10  # a start bit (0), 8 data bits from the lowest on, a stop bit (1)


def received_bytes(data: bytes, sent_baud: int, read_baud: int) -> bytes:
    """Return the bytes that a receiver at `read_baud` reads of `data`, sent at `sent_baud`.

    The bytes are sent without a pause. The receiver waits for the line to fall, samples it in the
    middle of each of its own bits, and then waits for the next fall. A missing stop bit is not
    reported: the byte counts.
    """
    if sent_baud == read_baud or not data:
        return data
    bits = np.unpackbits(np.frombuffer(data, np.uint8)[:, None], axis=1, bitorder="little")
    line = np.ones((len(data), _BITS), np.uint8)
    line[:, 0] = 0
    line[:, 1:9] = bits
    # The line is high before and long after.
    rest = _BITS * (1 + sent_baud // read_baud)
    levels: NDArray[np.uint8] = np.concatenate([[1], line.ravel(), np.ones(rest)]).astype(np.uint8)
    falls = np.flatnonzero((levels[:-1] == 1) & (levels[1:] == 0)) + 1
    step = sent_baud / read_baud  # one bit of the receiver, in bits of the sender
    middles = (np.arange(8) + 1.5) * step
    weights = 1 << np.arange(8)
    found = bytearray()
    at, k = 0.0, 0
    while (k := int(np.searchsorted(falls, at))) < len(falls):
        fall = float(falls[k])
        found.append(int(levels[(fall + middles).astype(int).clip(max=len(levels) - 1)] @ weights))
        at = fall + 9.5 * step
    return bytes(found)


Measure = Callable[[float], NDArray[np.float64]]

_WAKE_S = 0.05  # a thread that is to end notices it within this time
_ANSWERS = 4096  # bytes that wait for a host; of one that does not read nothing more is answered
_BAUDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdigit()
}


class BoardServer:
    """A board of `protocol` on a pseudo-terminal, which any program can open as a serial port.

    The k-th frame is measured `k / rate_hz` after the board was switched on, or not at all where
    the machine is late. While no program has the port open, nothing is measured. A program that
    has it open and does not read makes the board drop frames, as its numbers show.

    Attributes:
        port: the device to open, such as "/dev/pts/7".
        rate_hz: frames per second.
    """

    def __init__(
        self, protocol: type[Protocol], sensor: Sensor, measure: Measure, rate_hz: float
    ) -> None:
        self._baud = protocol.baud
        self._device = protocol.device(sensor)
        self._measure = measure
        self.rate_hz = rate_hz
        self._number = 0
        self._unsent = b""
        self._off = threading.Event()
        self._master, slave = pty.openpty()
        self.port = os.ttyname(slave)
        # Nothing is echoed, and bytes pass as they are, even before a program opens the port. It is
        # closed here, so that the last program to close it is noticed.
        tty.setraw(slave)
        speeds = termios.tcgetattr(slave)
        speeds[4] = speeds[5] = getattr(termios, f"B{self._baud}")
        termios.tcsetattr(slave, termios.TCSANOW, speeds)
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
                heard = received_bytes(os.read(self._master, 4096), self._host_baud(), self._baud)
                answer = self._device.obey(heard)
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
        self._unsent += received_bytes(data, self._baud, self._host_baud())
        with contextlib.suppress(OSError):
            self._unsent = self._unsent[os.write(self._master, self._unsent) :]

    def _host_baud(self) -> int:
        """The rate that the program has set; the board's own where that is a special one."""
        return _BAUDS.get(termios.tcgetattr(self._master)[5], self._baud)
