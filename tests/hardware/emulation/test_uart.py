"""A serial line whose ends are set to different rates."""

import pytest

from eitbench.hardware.emulation.board_server import received_bytes

TEXT = bytes(range(256)) * 3


def test_equal_rates_deliver_what_was_sent() -> None:
    assert received_bytes(TEXT, 9600, 9600) == TEXT
    assert received_bytes(b"", 9600, 19_200) == b""


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_clock_that_is_a_little_off_does_no_harm(factor: float) -> None:
    assert received_bytes(TEXT, 115_200, round(115_200 * factor)) == TEXT


def test_a_receiver_twice_as_fast_sees_every_bit_twice() -> None:
    # 0x55 is 0 1 0 1 0 1 0 1 0 1 on the line, so every fall starts a byte: 0, 0, 1, 1, 0, 0, ...
    # sampled behind the start bit as 0 1 1 0 0 1 1 0.
    assert received_bytes(b"\x55", 9600, 19_200)[0] == 0b01100110


def test_a_slow_receiver_loses_most_bytes() -> None:
    assert 20 < len(received_bytes(TEXT, 115_200, 9600)) < len(TEXT) / 8


@pytest.mark.parametrize("read", [300, 9600, 57_600, 230_400, 2_000_000])
def test_a_wrong_rate_delivers_something_else(read: int) -> None:
    heard = received_bytes(TEXT, 115_200, read)
    assert heard
    assert TEXT[:8] not in heard
