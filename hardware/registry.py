"""The registry of boards: built in, or installed (entry points in group `eitbench.boards`)."""

import warnings
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from eitbench.hardware.board import Board
from eitbench.hardware.emulation.emulator import RATE_HZ, Emulator
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.serial import ports
from eitbench.hardware.serial.serial_board import SERIAL_BOARDS
from eitbench.scenarios.catalogue import sensor as sensor_by_name
from eitbench.scenarios.docstrings import first_line
from eitbench.scenarios.errors import InputError, unknown_name
from eitbench.scenarios.sensors.sensor import Sensor

GROUP = "eitbench.boards"
MAX_SPEED = 100.0


def boards() -> dict[str, type[Board]]:
    """Every board by name.

    An installed one is a subclass of `Board` that is made from a sensor and a port, as a
    `SerialBoard` is. Taken names and packages that do not import are skipped with a warning.
    """
    known: dict[str, type[Board]] = {**SERIAL_BOARDS, "replay": Replay, "emulator": Emulator}
    for point in entry_points(group=GROUP):
        try:
            loaded = point.load()
        except Exception as error:  # a broken plugin must not take the others down
            problem = f"does not import: {error}"
        else:
            is_board = isinstance(loaded, type) and issubclass(loaded, Board)
            problem = "" if is_board else "is no Board"
            if point.name in known:
                problem = f"is named {point.name!r}, and that name is taken"
        if problem:
            warnings.warn(f"The installed board {point.value!r} {problem}.", stacklevel=2)
        else:
            known[point.name] = loaded
    return known


def make_board(
    name: str,
    *,
    port: str | None = None,
    sensor: Sensor | None = None,
    file: str | Path | None = None,
    speed: float | None = None,
    protocol: str | None = None,
    script: Path | None = None,
) -> Board:
    """Make the board called `name`.

    Args:
        name: registry name.
        port: serial port of a real board.
        sensor: nominal sensor on it; the board's default by default.
        file: recorded set or recording that `replay` plays.
        speed: of `replay` and `emulator`, times their own rate; 1 by default.
        protocol: what `emulator` speaks; "teensy" by default.
        script: file with touches of `emulator`.

    Raises:
        InputError: an unknown name (the nearest is suggested), a board without its port or file, or
            with an option that it does not take.
    """
    known = boards()
    if name not in known:
        raise unknown_name("board", name, known)
    board = known[name]
    options = {"port": port, "file": file, "script": script, "speed": speed, "protocol": protocol}
    for option, value in options.items():
        if value is not None and option not in board.options:
            raise InputError(f"Board {name!r} takes no {option}: leave out --{option}.")
    rate = 1.0 if speed is None else speed
    if name == "replay":
        if file is None:
            raise InputError(
                "Board 'replay' needs a recorded set (eitbench list recordings) or a recording "
                "(.h5): give --file."
            )
        return Replay(file, rate, sensor)
    if name == "emulator":
        return make_emulator(sensor, protocol or "teensy", script, rate)
    if port is None:
        raise ports.no_port(name)
    make: Any = board
    made: Board = make(sensor or sensor_by_name(board.default_sensor or ""), port)
    return made


def make_emulator(
    sensor: Sensor | None, protocol: str, script: Path | None, speed: float
) -> Emulator:
    """Make an emulated board; its default sensor is that of the board whose protocol it speaks.

    Raises:
        InputError: as in `make_board`.
    """
    if not 0 < speed <= MAX_SPEED:
        raise InputError(
            f"An emulated board runs at a speed above 0 and up to {MAX_SPEED:g}, got {speed:g}."
        )
    if protocol not in SERIAL_BOARDS:
        raise unknown_name("protocol", protocol, SERIAL_BOARDS)
    nominal = sensor or sensor_by_name(SERIAL_BOARDS[protocol].default_sensor)
    return Emulator(nominal, protocol, script, RATE_HZ * speed)


def board_rows() -> list[dict[str, str | int | None]]:
    """One row of plain values for each board, for listings."""
    return [
        {
            "name": name,
            "title": first_line(board),
            "baud": board.baud,
            "sensor": board.default_sensor,
        }
        for name, board in boards().items()
    ]
