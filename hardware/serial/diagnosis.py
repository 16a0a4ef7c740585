"""Diagnosis of a stream of bytes that holds none of the frames that are expected."""

from collections.abc import Callable

from eitbench.hardware.protocols import PROTOCOLS, Protocol

BAUDS = (9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600, 1_000_000, 2_000_000)
"""Rates that boards are usually set to [bit/s]."""

LEAST_BYTES = 64
"""Bytes that say something about a line."""
_FOREIGN = 0.01  # share of characters that no text has; what is read at a wrong rate has more


def diagnose(
    data: bytes, expected: type[Protocol], port: str, listen: Callable[[int], bytes]
) -> str | None:
    """Name the mistake that explains `data`, in one sentence; None if frames may still come.

    Args:
        data: the latest bytes from `port`, without a whole frame in them.
        expected: protocol that is expected.
        port: name of the serial port.
        listen: sets the port to a rate [bit/s] and returns the bytes that come at it for a while.
    """
    if len(data) < LEAST_BYTES or expected.recognises(data):
        return None
    # What is read at a wrong rate may be printable, too, so that text is considered last.
    for baud in (expected.baud, *BAUDS):
        heard = data if baud == expected.baud else listen(baud)
        for name, protocol in PROTOCOLS.items():
            if protocol.recognises(heard):
                return (
                    f"What {port} sends at {baud} bit/s looks like board {name!r}, not "
                    f"{expected.name!r} at {expected.baud} bit/s: set the board to that rate, or "
                    f"give --board {name}."
                )
    if is_text(data):
        line = data[data.find(b"\n") + 1 :].partition(b"\n")[0]
        begin = line.strip()[:40].decode(errors="replace")
        return (
            f"{port} sends text that no known board sends, such as {begin!r}: see whether it is "
            "the port of the board."
        )
    return (
        f"What {port} sends at {expected.baud} bit/s is neither text nor frames: most likely the "
        f"board has a wrong baud rate; set it to {expected.baud}, the rate of {expected.name!r}."
    )


def is_text(data: bytes) -> bool:
    """True if nearly all characters of `data` are printable."""
    text = data.decode(errors="replace")
    foreign = sum(not (c.isprintable() or c in "\t\r\n") or c == "\ufffd" for c in text)
    return foreign <= _FOREIGN * len(text)
