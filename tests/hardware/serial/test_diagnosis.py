"""Diagnosis of bytes that are no frames: wrong rate, another board, another program."""

import random
from collections.abc import Callable
from typing import Any

import pytest

from eitbench.hardware.emulation.board_server import received_bytes
from eitbench.hardware.protocols import PROTOCOLS
from eitbench.hardware.serial.diagnosis import diagnose

Stream = Callable[..., Any]
PORT = "/dev/ttyACM0"


def diagnosed(spoken: str, expected: str, stream: Stream, sent_baud: int | None = None) -> str:
    """The sentence on a board that speaks `spoken` where `expected` is awaited."""
    sent = b"".join(stream(spoken, 5).messages)
    baud = sent_baud or PROTOCOLS[spoken].baud

    def listen(at_baud: int) -> bytes:
        return received_bytes(sent, baud, at_baud)

    data = listen(PROTOCOLS[expected].baud)
    return str(diagnose(data, PROTOCOLS[expected], PORT, listen))


@pytest.mark.parametrize("name", ["eit-kit", "openeit"])
@pytest.mark.parametrize("baud", [9600, 57_600, 230_400])
def test_a_wrong_baud_rate_is_named(
    name: str, baud: int, stream: Stream, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PROTOCOLS[name], "baud", baud)  # the host's; the board has its own
    sentence = diagnosed(name, name, stream, 115_200)
    assert "wrong baud rate" in sentence
    assert f"115200 bit/s; set it to {baud}" in sentence


@pytest.mark.parametrize(
    ("spoken", "expected"),
    [
        ("openeit", "eit-kit"),
        ("eit-kit", "openeit"),
        ("openeit", "teensy"),
        ("eit-kit", "sciospec"),
        ("sciospec", "openeit"),
        ("teensy", "openeit"),
    ],
)
def test_another_boards_protocol_is_named(spoken: str, expected: str, stream: Stream) -> None:
    sentence = diagnosed(spoken, expected, stream)
    assert f"board '{spoken}', not '{expected}'" in sentence
    assert f"--board {spoken}" in sentence


def test_its_own_frames_and_too_few_bytes_are_no_mistake(name: str, stream: Stream) -> None:
    expected = PROTOCOLS[name]
    own = b"".join(stream(name, 3).messages)
    for data in (own[100:], b"x" * 50):
        assert diagnose(data, expected, PORT, lambda baud: b"") is None


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (random.Random(0).randbytes(1000), "most likely the board has a wrong baud rate"),
        (b"GPS fix lost, searching\n" * 10, "'GPS fix lost, searching'"),
    ],
)
def test_noise_and_text_of_another_program(data: bytes, says: str) -> None:
    assert says in str(diagnose(data, PROTOCOLS["eit-kit"], PORT, lambda baud: b""))
