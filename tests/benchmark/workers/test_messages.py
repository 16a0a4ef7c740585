"""Messages of workers: whatever the bytes are, they are a reply or refused."""

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from eitbench.benchmark.workers import messages
from eitbench.benchmark.workers.messages import Failure, Reply, decode, encode

OK = encode(Reply({"images": np.ones((2, 3), np.float32), "said": "ü"}, 0.5, None, 10.0))
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


def message(header: object, content: bytes = b"") -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(4) + text + content


def header(**changes: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "value": None,
        "seconds": 0.1,
        "failure": None,
        "memory_mb": 1.0,
        "arrays": [],
    }
    return plain | changes


def read(content: bytes) -> Reply | None:
    """The reply, or None where it is refused; nothing else may happen."""
    try:
        reply = decode(content)
    except ValueError:
        return None
    assert isinstance(reply, Reply)
    assert math.isfinite(reply.seconds)
    return reply


@given(st.binary())
@LIMITED
def test_any_bytes_are_a_reply_or_refused(content: bytes) -> None:
    read(content)


@given(st.binary(max_size=60), st.integers(0, len(OK)), st.integers(0, len(OK)))
@LIMITED
def test_a_damaged_message_is_a_reply_or_refused(piece: bytes, start: int, stop: int) -> None:
    read(OK[:start] + piece + OK[stop:])


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
    same(decode(encode(Reply(value, 0.0))).value, value)


def test_a_failure_comes_back_without_a_value() -> None:
    failure = Failure("invalid-output", "returned nothing", ("shape",), '  File "a.py", line 1')
    reply = decode(encode(Reply([1], 0.5, failure)))
    assert reply.failure == failure
    assert reply.value is None


class Odd:
    def __str__(self) -> str:
        return "\ud800" + "x" * 10**6


def test_texts_are_shortened_and_can_be_written() -> None:
    long = "\ud800" + "x" * 10**6
    said = {long: [long, Odd(), np.str_("fine")], "number": np.int64(3)}
    for reply in (
        decode(encode(Reply(said, 0.0))),
        decode(message(header(value={long[:5000]: [long[:5000]] * 2 + ["fine"], "number": 3}))),
    ):
        (key, texts), (_, number) = reply.value.items()
        assert key == texts[0] == texts[1] == "\\ud800" + "x" * 493 + "…"
        assert texts[2] == "fine"
        assert number == 3
        key.encode()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        (2**32 - 1).to_bytes(4),
        message(header(extra=1)),
        message(header(seconds=math.nan)),
        message(header(seconds=-1.0)),
        message(header(seconds=math.inf)),
        message(header(failure={"status": "fine", "message": "", "kinds": []})),
        message(header(arrays=[{"dtype": "|O", "shape": [1]}]), bytes(8)),
        message(header(arrays=[{"dtype": "<f8", "shape": [2**40, 2**40]}])),
        message(header(arrays=[{"dtype": "<f8", "shape": [2]}]), bytes(8)),
        message(header(), b"more"),
        message([0]) + b"[" * 50_000,
        (50_000).to_bytes(4) + b"[" * 50_000,
        message(header(value="x" * messages.MAX_HEADER)),
    ],
)
def test_what_no_worker_sends_is_refused(content: bytes) -> None:
    assert read(content) is None


@pytest.mark.parametrize("limit", ["MAX_HEADER", "MAX_ARRAYS"])
def test_an_answer_that_is_too_large_is_not_sent(
    limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(messages, limit, 100)
    with pytest.raises(ValueError, match="more than 100 bytes"):
        encode(Reply([np.zeros(1000), "x" * 400], 0.0))
