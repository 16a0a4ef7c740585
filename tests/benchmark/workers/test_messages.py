"""Messages of workers: whatever the bytes are, they are a reply or refused."""

import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from eitbench.benchmark.workers import messages
from eitbench.benchmark.workers.messages import Failure, Reply, decode, encode

OK = [bytes(part) for part in encode(Reply({"images": np.ones((2, 3), np.float32), "ü": "ü"}, 0.5))]
LIMITED = settings(max_examples=100, deadline=None)

leaves = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20)
    | arrays.arrays(
        st.sampled_from([np.float32, np.float64, np.uint64]),
        arrays.array_shapes(min_dims=0, min_side=0, max_side=3),
    )
)  # fmt: skip
values = st.recursive(
    leaves, lambda of: st.lists(of, max_size=3) | st.dictionaries(st.text(max_size=5), of)
)


def message(header: object, *content: bytes) -> list[bytes]:
    return [json.dumps(header).encode(), *content]


def sent(pieces: Iterable[bytes | memoryview]) -> Reply:
    """The reply of a message, received as a connection does."""
    left = iter(pieces)

    def receive(most: int) -> bytes:
        piece = bytes(next(left, b""))  # b"" where a connection would wait
        if len(piece) > most:
            raise OSError
        return piece

    return decode(receive)


def header(**changes: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "value": None,
        "seconds": 0.1,
        "failure": None,
        "memory_mb": 1.0,
        "arrays": [],
    }
    return plain | changes


def read(pieces: Iterable[bytes]) -> Reply | None:
    """The reply, or None where it is refused; nothing else may happen."""
    try:
        reply = sent(pieces)
    except (ValueError, OSError):
        return None
    assert isinstance(reply, Reply)
    assert math.isfinite(reply.seconds)
    return reply


@given(st.lists(st.binary()))
@LIMITED
def test_any_bytes_are_a_reply_or_refused(pieces: list[bytes]) -> None:
    read(pieces)


@given(st.binary(max_size=60), st.sampled_from([0, 1]), st.tuples(*2 * [st.integers(0, 200)]))
@LIMITED
def test_a_damaged_message_is_a_reply_or_refused(
    piece: bytes, which: int, cut: tuple[int, int]
) -> None:
    damaged = OK.copy()
    damaged[which] = OK[which][: cut[0]] + piece + OK[which][cut[1] :]
    read(damaged)


@pytest.mark.slow
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists), st.binary())
@LIMITED
def test_any_header_is_a_reply_or_refused(part: Any, content: bytes) -> None:
    for name in header():
        read(message(header(**{name: part}), content))
    read(message(header(arrays=[{"dtype": "<f8", "shape": part}]), content))


def same(one: Any, other: Any) -> None:
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            same(one[name], other[name])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for pair in zip(one, other, strict=True):
            same(*pair)
    else:
        assert one == other
        assert type(one) is type(other)


@pytest.mark.slow
@given(values)
@LIMITED
def test_values_come_back(value: Any) -> None:
    same(sent(encode(Reply(value, 0.0))).value, value)


def test_a_failure_comes_back_without_a_value() -> None:
    failure = Failure("invalid-output", "returned nothing", ("shape",), '  File "a.py", line 1')
    reply = sent(encode(Reply([1], 0.5, failure)))
    assert reply.failure == failure
    assert reply.value is None


class Odd:
    def __str__(self) -> str:
        return "\ud800" + "x" * 10**6


def test_texts_are_shortened_and_can_be_written() -> None:
    long = "\ud800" + "x" * 10**6
    said = {long: [long, Odd(), np.str_("fine")], "number": np.int64(3)}
    for reply in (
        sent(encode(Reply(said, 0.0))),
        sent(message(header(value={long[:5000]: [long[:5000]] * 2 + ["fine"], "number": 3}))),
    ):
        (key, texts), (_, number) = reply.value.items()
        assert key == texts[0] == texts[1] == "\\ud800" + "x" * 493 + "…"
        assert texts[2] == "fine"
        assert number == 3
        key.encode()


@pytest.mark.parametrize(
    "content",
    [
        [],
        [b""],
        message(header(extra=1)),
        message(header(seconds=math.nan)),
        message(header(seconds=-1.0)),
        message(header(seconds=math.inf)),
        message(header(failure={"status": "fine", "message": "", "kinds": []})),
        message(header(arrays=[{"dtype": "|O", "shape": [1]}]), bytes(8)),
        message(header(arrays=[{"dtype": "<f8", "shape": [2**40, 2**40]}])),
        message(header(arrays=[{"dtype": "<f8", "shape": [2]}]), bytes(8)),
        message(header(arrays=[{"dtype": "<f8", "shape": [2]}]), bytes(8), bytes(9)),
        [b"[" * 50_000],
        message(header(value="x" * messages.MAX_HEADER)),
    ],
)
def test_what_no_worker_sends_is_refused(content: list[bytes]) -> None:
    assert read(content) is None


def test_an_array_is_sent_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(messages, "PIECE", 100)
    array = np.arange(60.0).reshape(12, 5).T
    pieces = encode(Reply(array, 0.0))
    assert [len(piece) for piece in pieces[1:]] == [100, 100, 100, 100, 80]
    assert sent(pieces).value.flags.writeable
    same(sent(pieces).value, array)


@pytest.mark.parametrize("limit", ["MAX_HEADER", "MAX_ARRAYS"])
def test_an_answer_that_is_too_large_is_not_sent(
    limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, limit, 100)
    with pytest.raises(ValueError, match="more than 100 bytes"):
        encode(Reply([np.zeros(1000), "x" * 400], 0.0))
