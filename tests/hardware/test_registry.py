"""The registry of boards: built in, installed, and what each takes."""

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from eitbench.hardware import registry
from eitbench.hardware.emulation.emulator import Emulator
from eitbench.hardware.registry import board_rows, boards, make_board
from eitbench.hardware.serial import ports
from eitbench.hardware.serial.serial_board import SERIAL_BOARDS, SciospecBoard, TeensyBoard
from eitbench.scenarios.catalogue import sensor
from eitbench.scenarios.errors import InputError


class Installed(TeensyBoard):
    """A board of another package."""


def installed(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    point = EntryPoint(name, value, registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])


def test_all_boards_are_listed() -> None:
    assert set(boards()) == {*SERIAL_BOARDS, "replay", "emulator"}
    rows = {row["name"]: row for row in board_rows()}
    assert rows["openeit"]["baud"] == 115_200
    assert rows["sciospec"]["sensor"] == "sciospec-tank"
    assert str(rows["emulator"]["title"]).startswith("An emulated board")
    assert all(row["title"] for row in rows.values())


def test_an_installed_board_is_made_from_a_sensor_and_a_port(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(EntryPoint, "load", lambda self: Installed)
    installed(monkeypatch, "my-board", "mine:Installed")
    board = make_board("my-board", port="/dev/ttyACM0")
    assert isinstance(board, Installed)
    assert board.port == "/dev/ttyACM0"


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("my-board", "no_such_package:Board", "does not import"),
        ("my-board", "pathlib:Path", "is no Board"),
        ("teensy", "eitbench.hardware.emulation.emulator:Emulator", "'teensy'"),
    ],
)
def test_a_broken_plugin_is_passed_over_with_a_warning(
    name: str, value: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed(monkeypatch, name, value)
    with pytest.warns(UserWarning, match=says):
        known = boards()
    assert known["teensy"] is TeensyBoard
    assert "my-board" not in known


def test_boards_have_their_default_sensor_or_the_one_that_is_named() -> None:
    board = make_board("sciospec", port="/dev/ttyUSB0")
    assert isinstance(board, SciospecBoard)
    assert board.sensor == sensor("sciospec-tank")
    assert make_board("teensy", port="p", sensor=sensor("ohmc8")).sensor.name == "ohmc8"
    assert make_board("emulator", protocol="openeit").sensor.name == "ohmc16"


def test_the_emulator_runs_at_a_multiple_of_its_rate() -> None:
    board = make_board("emulator", speed=3)
    assert isinstance(board, Emulator)
    assert board._rate_hz == 30


@pytest.mark.parametrize(
    ("name", "choices", "says"),
    [
        ("tensy", {}, "Unknown board 'tensy': did you mean 'teensy'"),
        ("teensy", {}, "needs a serial port, and those that exist are /dev/ttyACM0: give --port"),
        ("teensy", {"port": "p", "file": "x"}, "'teensy' takes no file: leave out --file"),
        ("emulator", {"port": "p"}, "'emulator' takes no port"),
        ("replay", {"file": "ohmc16", "script": Path("x")}, "'replay' takes no script"),
        ("teensy", {"port": "p", "speed": 2.0}, "'teensy' takes no speed: leave out --speed"),
        ("replay", {"file": "ohmc16", "protocol": "openeit"}, "'replay' takes no protocol"),
        ("replay", {}, "give --file"),
        ("emulator", {"protocol": "opneeit"}, "did you mean 'openeit'"),
        ("emulator", {"speed": 0.0}, "at a speed above 0"),
        ("emulator", {"protocol": "openeit", "sensor": "foam16"}, "has another pattern"),
    ],
)
def test_a_wrong_choice_is_named(
    name: str, choices: dict[str, Any], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ports, "ports", lambda: ["/dev/ttyACM0"])
    if "sensor" in choices:
        choices = {**choices, "sensor": sensor(choices["sensor"])}
    with pytest.raises(InputError) as caught:
        make_board(name, **choices)
    assert says in str(caught.value)
