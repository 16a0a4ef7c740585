"""What a stream of bytes looks like that holds none of the frames that are expected."""

import string

from eitbench.hardware.protocols import PROTOCOLS, Protocol

_TEXT = string.printable.encode()
_LEAST = 64  # bytes that say something about a line


def diagnose(data: bytes, expected: type[Protocol], port: str) -> str | None:
    """What is wrong with `data`, as one sentence; None if it may still become frames.

    Args:
        data: what came last from `port`, without a whole frame in it.
        expected: what it should be.
        port: where it came from.
    """
    if len(data) < _LEAST or expected.recognises(data):
        return None
    for name, protocol in PROTOCOLS.items():
        if protocol.recognises(data):
            return (
                f"What {port} sends looks like board {name!r}, not {expected.name!r}: give "
                f"--board {name}."
            )
    if is_text(data):
        begin = data[: data.find(b"\n", 1)][:40].strip().decode(errors="replace")
        return (
            f"{port} sends text that no known board sends, such as {begin!r}: see whether it is "
            "the port of the board."
        )
    return (
        f"What {port} sends at {expected.baud} bit/s is neither text nor frames: most likely the "
        f"board is set to another baud rate; set it to {expected.baud}, the rate of "
        f"{expected.name!r}."
    )


def is_text(data: bytes) -> bool:
    """Whether nearly all of `data` are printable ASCII characters."""
    return len(data.translate(None, _TEXT)) <= 0.05 * len(data)
