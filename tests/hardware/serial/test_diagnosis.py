"""Diagnosis of bytes that are no frames: wrong rate, another board, another program."""

import random
from collections.abc import Callable
from typing import Any

import pytest

from eitbench.hardware.protocols import PROTOCOLS
from eitbench.hardware.serial.diagnosis import diagnose

Stream = Callable[..., Any]
PORT = "/dev/ttyACM0"


NOISE = random.Random(0).randbytes(1000)
"""What is read at another rate than the board's."""


@pytest.mark.parametrize(
    ("spoken", "expected", "baud"),
    [
        ("openeit", "eit-kit", 115_200),
        ("eit-kit", "openeit", 115_200),
        ("openeit", "teensy", 115_200),
        ("eit-kit", "sciospec", 115_200),
        ("sciospec", "openeit", 115_200),
        ("teensy", "openeit", 2_000_000),
        ("eit-kit", "eit-kit", 9600),
    ],
)
def test_another_boards_protocol_or_rate_is_named(
    spoken: str, expected: str, baud: int, stream: Stream
) -> None:
    sent = b"".join(stream(spoken, 5).messages)

    def listen(at_baud: int) -> bytes:
        return sent if at_baud == baud else NOISE

    data = listen(PROTOCOLS[expected].baud)
    sentence = str(diagnose(data, PROTOCOLS[expected], PORT, listen))
    assert f"at {baud} bit/s looks like board '{spoken}', not '{expected}' at" in sentence


def test_its_own_frames_and_too_few_bytes_are_no_mistake(name: str, stream: Stream) -> None:
    expected = PROTOCOLS[name]
    own = b"".join(stream(name, 3).messages)
    for data in (own[100:], b"x" * 50):
        assert diagnose(data, expected, PORT, lambda baud: b"") is None


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (NOISE, "most likely the board has a wrong baud rate"),
        (b"GPS fix lost, searching\n" * 10, "'GPS fix lost, searching'"),
    ],
)
def test_noise_and_text_of_another_program(data: bytes, says: str) -> None:
    assert says in str(diagnose(data, PROTOCOLS["eit-kit"], PORT, lambda baud: b""))
