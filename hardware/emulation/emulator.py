"""A board on a pseudo-terminal with an emulated sensor behind it."""

import time
from pathlib import Path
from typing import ClassVar

from eitbench.hardware.board import Board, BoardError, Frame
from eitbench.hardware.emulation.board_server import BoardServer
from eitbench.hardware.emulation.emulated_sensor import EmulatedSensor, Touch, read_script
from eitbench.hardware.serial.serial_board import SERIAL_BOARDS, SerialBoard
from eitbench.scenarios.sensors.sensor import Sensor

RATE_HZ = 10.0


class Emulator(Board):
    """An emulated board on a pseudo-terminal, which speaks any of the protocols.

    Args:
        sensor: the nominal sensor; the emulated one behind the board differs from it.
        protocol: the board that it speaks as, one of `SERIAL_BOARDS`.
        script: a file with touches.
        rate_hz: frames per second.

    Raises:
        InputError: a sensor that boards of this kind cannot measure, or a wrong script.
    """

    options: ClassVar[frozenset[str]] = frozenset({"script", "speed", "protocol"})
    can_be_pressed: ClassVar[bool] = True

    def __init__(
        self,
        sensor: Sensor,
        protocol: str = "teensy",
        script: Path | None = None,
        rate_hz: float = RATE_HZ,
    ) -> None:
        super().__init__(sensor, emulated=True)
        self._board = SERIAL_BOARDS[protocol]
        self._board.protocol.check(sensor)
        self._script = None if script is None else read_script(script, sensor)
        self._rate_hz = rate_hz
        self._press: Touch | None = None
        self._emulated: EmulatedSensor | None = None
        self._server: BoardServer | None = None
        self._host: SerialBoard | None = None

    @property
    def port(self) -> str:
        """Serial port that it is on while it is switched on.

        Raises:
            BoardError: it is switched off.
        """
        if self._server is None:
            raise BoardError("The emulated board is switched off: open it first.")
        return self._server.port

    def switch_on(self) -> None:
        """Put it on a port of its own, for this program or another to open."""
        self.switch_off()
        if self._emulated is None:
            self._emulated = EmulatedSensor(self.sensor)
            self._emulated.frame(0.0, ())  # the first takes long, as loops may have to be compiled
            # The sensor warms up and ages once, however often the board is switched on.
            self._made_s = time.monotonic()
        emulated, age_s = self._emulated, time.monotonic() - self._made_s
        self._server = BoardServer(
            self._board.protocol,
            self.sensor,
            lambda time_s: emulated.frame(
                age_s + time_s, self.touches(age_s + time_s), 1 / self._rate_hz
            ),
            self._rate_hz,
        )
        self._server.start()

    def switch_off(self) -> None:
        """Take it off its port; no error if it is off."""
        if self._server is not None:
            self._server.stop()
            self._server = None

    def serve(self) -> None:
        """Wait until it is switched off."""
        if self._server is not None:
            self._server.wait()

    def open(self) -> None:
        """Switch it on, and take hold of its port as of any other."""
        self.close()
        self.switch_on()
        self._host = self._board(self.sensor, self.port)
        try:
            self._host.open()
        except BoardError:
            self.close()
            raise
        self.health, self.firmware = self._host.health, self._host.firmware

    def start(self) -> None:
        """Start measuring."""
        self._opened.start()

    def frames(self, wait_s: float) -> list[Frame]:
        """Return the frames that have arrived since the last call."""
        return self._opened.frames(wait_s)

    def stop(self) -> None:
        """Pause."""
        self._opened.stop()

    def close(self) -> None:
        """Let go of it and switch it off."""
        if self._host is not None:
            self._host.close()
            self._host = None
        self.switch_off()

    @property
    def _opened(self) -> SerialBoard:
        if self._host is None:
            raise BoardError("The emulated board is not open: open it first.")
        return self._host

    def touches(self, time_s: float) -> list[Touch]:
        """Touches at `time_s` [s] after it was first switched on."""
        scripted = [] if self._script is None else self._script.at(time_s)
        press = self._press
        return scripted if press is None else [*scripted, press]

    def press(self, x_m: float, y_m: float, radius_m: float, pressure_pa: float) -> None:
        """Press the emulated sensor, beside the touches of the script."""
        self._press = Touch(x_m, y_m, radius_m, pressure_pa)

    def release(self) -> None:
        """End the press; scripted touches go on."""
        self._press = None
