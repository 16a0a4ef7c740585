"""Bytes that a serial line delivers when its ends are set to different rates."""

import numpy as np
from numpy.typing import NDArray

_BITS = 10  # a start bit (0), 8 data bits from the lowest on, a stop bit (1)


def received_bytes(data: bytes, sent_baud: int, read_baud: int) -> bytes:
    """Return the bytes that a receiver at `read_baud` reads of `data`, sent at `sent_baud`.

    The bytes are sent without a pause. The receiver waits for the line to fall, samples it in the
    middle of each of its own bits, and then waits for the next fall. A missing stop bit is not
    reported: the byte counts.
    """
    if sent_baud == read_baud or not data:
        return data
    bits = np.unpackbits(np.frombuffer(data, np.uint8)[:, None], axis=1, bitorder="little")
    line = np.ones((len(data), _BITS), np.uint8)
    line[:, 0] = 0
    line[:, 1:9] = bits
    # The line is high before and long after.
    rest = _BITS * (1 + sent_baud // read_baud)
    levels: NDArray[np.uint8] = np.concatenate([[1], line.ravel(), np.ones(rest)]).astype(np.uint8)
    falls = np.flatnonzero((levels[:-1] == 1) & (levels[1:] == 0)) + 1
    step = sent_baud / read_baud  # one bit of the receiver, in bits of the sender
    middles = (np.arange(8) + 1.5) * step
    weights = 1 << np.arange(8)
    found = bytearray()
    at, k = 0.0, 0
    while (k := int(np.searchsorted(falls, at))) < len(falls):
        fall = float(falls[k])
        found.append(int(levels[(fall + middles).astype(int).clip(max=len(levels) - 1)] @ weights))
        at = fall + 9.5 * step
    return bytes(found)
