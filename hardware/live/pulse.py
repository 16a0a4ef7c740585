"""How often frames come, and how noisy they are."""

import time
from collections import deque

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Frame

Array = NDArray[np.float64]

WINDOW_S = 2.0
_TRIPLES = 30


class Pulse:
    """Rate and noise of the frames of the last seconds."""

    def __init__(self) -> None:
        self._received: deque[float] = deque()
        self._values: deque[Array] = deque(maxlen=3)
        self._snr_db: deque[float] = deque(maxlen=_TRIPLES)

    def add(self, frame: Frame) -> None:
        """Count `frame`."""
        self._received.append(frame.received_s)
        while self._received[0] < frame.received_s - WINDOW_S:
            self._received.popleft()
        self._values.append(frame.values)
        if len(self._values) == 3:
            self._snr_db.append(_snr_db(*self._values))

    @property
    def rate_hz(self) -> float:
        """Frames per second over the last seconds; 0 if none came."""
        received = [at for at in tuple(self._received) if at > time.monotonic() - WINDOW_S]
        if len(received) < 2 or received[-1] == received[0]:
            return 0.0
        return (len(received) - 1) / (received[-1] - received[0])

    @property
    def snr_db(self) -> float:
        """Median SNR [dB] of the last frames; NaN if there are too few, or they hold no noise."""
        known = [value for value in tuple(self._snr_db) if np.isfinite(value)]
        return float(np.median(known)) if known else float("nan")


def _snr_db(first: Array, second: Array, third: Array) -> float:
    """SNR [dB] of three frames that follow each other.

    What changes evenly, as drift does, has no second difference; white noise of variance s^2 gives
    one of variance 6 s^2. A touch that begins or ends costs a triple or two, which a median bears.
    """
    noise = np.sqrt(np.mean((first - 2 * second + third) ** 2) / 6)
    signal = np.sqrt(np.mean(second**2))
    return float(20 * np.log10(signal / noise)) if noise > 0 < signal else float("nan")
