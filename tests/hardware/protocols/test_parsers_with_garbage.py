"""Parsers under random and mutated bytes: no crash, bounded memory, good frames recovered."""

import random
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import psutil
import pytest

from eitbench.hardware.protocols import Device, Protocol, teensy
from eitbench.hardware.protocols.lines import LONGEST

MakeStream = Callable[..., Any]

# What looks like the beginning of something, or never ends.
LURES = {
    "teensy": [
        teensy.SYNC * 50,
        teensy.encode(1, 0, 0.0, np.ones(4096))[:24],  # a length that lies
    ],
    "sciospec": [b"\xb4\x89\x01" * 60, b"\xb4" * 300, b"\x18\x01\x83", b"\xb4\x89\x01\x01\x04"],
    "openeit": [b"magnitudes: ", b"magnitudes: 1.0000," * 90, b"1.0000," * 20_000],
    "eit-kit": [b"0.0000, " * 300, b"FRAME_DATA,", b"1" * 100_000, b"FRAME_DATA,1.0,-.,\n"],
}


def kept(parser: Protocol | Device) -> int:
    """Bytes that one end keeps for later."""
    parts: list[Any] = [v for v in vars(parser).values() if isinstance(v, bytes | bytearray | list)]
    if hasattr(parser, "_scanner"):
        parts.append(parser._scanner._buffer)
    return sum(map(sys.getsizeof, parts))


def recovers(sent: Any, parser: Protocol) -> bool:
    """True if all frames that follow come out, and come out last."""
    frames = parser.feed(b"".join(sent.messages[1:4]), 0.0)
    return len(frames) >= 3 and all(
        sent.holds(k, frame.values) for k, frame in enumerate(frames[-3:], start=1)
    )


@pytest.mark.parametrize("seed", range(5))
def test_frames_after_random_bytes_are_recovered(name: str, seed: int, stream: MakeStream) -> None:
    sent = stream(name, 4)
    parser = sent.parser()
    assert parser.feed(random.Random(seed).randbytes(20_000), 0.0) == []
    assert recovers(sent, parser)


def test_frames_after_what_looks_like_one_are_recovered(name: str, stream: MakeStream) -> None:
    sent = stream(name, 4)
    for lure in LURES[name]:
        parser = sent.parser()
        parser.feed(lure, 0.0)
        assert recovers(sent, parser), lure[:20]


def test_frames_after_one_that_was_cut_short_are_recovered(name: str, stream: MakeStream) -> None:
    sent = stream(name, 4)
    message = sent.messages[0]
    for length in range(1, len(message), 13):
        for piece in (message[:length], message[length:]):
            parser = sent.parser()
            parser.feed(piece, 0.0)
            assert recovers(sent, parser), length


def test_a_lost_byte_costs_one_frame_however_the_rest_is_cut(name: str, stream: MakeStream) -> None:
    sent = stream(name, 4)
    message = sent.messages[1]
    for lost in (139, 140 * 5 + 70, len(message) // 2):
        data = sent.messages[0] + message[:lost] + message[lost + 1 :] + sent.messages[2]
        parser = sent.parser()
        frames = [f for at in range(len(data)) for f in parser.feed(data[at : at + 1], 0.0)]
        assert sent.holds(0, frames[0].values)
        assert sent.holds(2, frames[-1].values)


def test_a_stream_without_an_end_is_not_kept(name: str, stream: MakeStream) -> None:
    sent = stream(name, 4)
    for byte in (b"0", b"\xb4", b"\xa5", b",", b"\xff"):
        parser = sent.parser()
        for _ in range(80):
            parser.feed(byte * (LONGEST // 2), 0.0)
        assert kept(parser) < 4 * LONGEST
        assert recovers(sent, parser)


def mutated(chance: random.Random, message: bytes) -> bytes:
    """`message` with a few bytes changed, lost, doubled or put in."""
    raw = bytearray(message)
    for _ in range(chance.randrange(1, 5)):
        at = chance.randrange(len(raw) + 1)
        kind = chance.randrange(5)
        if kind == 0:
            raw[at : at + 1] = chance.randbytes(1)
        elif kind == 1:
            del raw[at : at + chance.randrange(1, 200)]
        elif kind == 2:
            raw[at:at] = chance.randbytes(chance.randrange(1, 20))
        elif kind == 3:
            raw[at:at] = raw[at : at + chance.randrange(1, 200)]
        else:
            del raw[at:]
    return bytes(raw)


def fuzz(sent: Any, strings: int) -> int:
    """Feed so many strings to one parser; good frames must come out after every hundredth.

    Half of them are random, half mutated frames; they come in one piece or two. Returns by how
    much memory has grown [bytes].
    """
    chance = random.Random(sent.protocol.name)
    process = psutil.Process()
    parser = sent.parser()
    before, most = process.memory_info().rss, 0
    for k in range(strings):
        if chance.random() < 0.5:
            text = chance.randbytes(chance.randrange(300))
        else:
            text = mutated(chance, chance.choice(sent.messages))
        cut = chance.randrange(len(text) + 1)
        parser.feed(text[:cut], 0.0)
        parser.feed(text[cut:], 0.0)
        if k % 100 == 99:
            assert kept(parser) < 4 * LONGEST
            assert recovers(sent, parser), k
            most = max(most, process.memory_info().rss)
    return most - before


def test_random_and_mutated_strings(name: str, stream: MakeStream) -> None:
    fuzz(stream(name, 4), 3000)


@pytest.mark.nightly
def test_a_million_random_and_mutated_strings(name: str, stream: MakeStream) -> None:
    assert fuzz(stream(name, 4), 1_000_000) < 64 << 20


def test_the_boards_end_outlives_any_command(name: str, stream: MakeStream) -> None:
    chance, sent = random.Random(5), stream(name, 1)
    device = sent.protocol.device(sent.sensor)
    for _ in range(2000):
        device.obey(chance.randbytes(chance.randrange(40)))
        device.obey(chance.choice([b"\xb0", b"\xb4\x01", b"start", b"c"]))
    assert kept(device) < 2000
    for command in (b"\0" * 16, b"\n", *sent.parser().starting()):
        device.obey(command)
    assert sent.parser().feed(device.encode(0, 0.0, sent.values[0]), 0.0)
