"""Serial ports that cannot be used: missing, forbidden, in use, none."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from eitbench.hardware.board import BoardError
from eitbench.hardware.emulation.board_server import BoardServer
from eitbench.hardware.serial.serial_board import TeensyBoard
from eitbench.scenarios.sensors.sensor import foam16

Serve = Callable[..., BoardServer]


def teensy(port: str) -> TeensyBoard:
    return TeensyBoard(foam16(), port)


def test_a_port_that_is_missing_is_answered_with_those_that_exist(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = [
        SimpleNamespace(device="/dev/ttyUSB1", description="n/a"),
        SimpleNamespace(device="/dev/ttyACM0", description="USB Serial"),
    ]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: found)
    with pytest.raises(
        BoardError,
        match=r"no serial port /dev/ttyACM7: plug the board in, or name another; those that exist "
        r"are /dev/ttyACM0 \(USB Serial\), /dev/ttyUSB1\.",
    ):
        teensy("/dev/ttyACM7").open()
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [])
    with pytest.raises(BoardError, match="there is none on this machine"):
        teensy("/dev/ttyACM7").open()


def test_a_file_is_no_port(tmp_path: Any) -> None:
    path = tmp_path / "x"
    path.write_text("")
    for port in (str(path), "/dev/null", ""):
        with pytest.raises(BoardError, match=f"^'{port}' is no serial port: "):
            teensy(port).open()


@pytest.mark.skipif(
    getattr(os, "geteuid", lambda: -1)() != 0, reason="becomes another user: run as root"
)
def test_a_port_that_may_not_be_used_names_its_group(terminal: tuple[int, str]) -> None:
    port = terminal[1]
    grp = pytest.importorskip("grp")  # not on Windows
    group = next(g for g in grp.getgrall() if g.gr_gid not in (0, os.getegid()))
    os.chown(port, 0, group.gr_gid)
    Path(port).chmod(0o660)
    os.seteuid(65534)
    try:
        with pytest.raises(BoardError, match=f"usermod -aG {group.gr_name} "):
            teensy(port).open()
    finally:
        os.seteuid(0)


HOLD = """
import sys, time
{how}
print("held", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(
    "how",
    [
        "import serial; line = serial.Serial(sys.argv[1], exclusive=True)",
        "line = open(sys.argv[1], 'rb', buffering=0)",  # a program that locks nothing
    ],
)
def test_a_port_in_use_names_the_program(how: str, serve: Serve) -> None:
    port = serve("teensy").port
    command = [sys.executable, "-c", HOLD.format(how=how), port]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(
            BoardError, match=rf"is in use by python.*\(process {other.pid}\): close it there"
        ):
            teensy(port).open()
        other.kill()
    with teensy(port) as board:
        board.start()
        assert board.frames(2.0)


def test_a_port_is_opened_once_by_one_program(serve: Serve) -> None:
    port = serve("teensy").port
    with teensy(port), pytest.raises(BoardError, match=f"{port} is in use"):
        teensy(port).open()
