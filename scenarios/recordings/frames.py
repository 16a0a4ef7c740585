"""Frames that no board can have measured."""

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array

MAX_VALUE = 1e10
"""No board measures so much [V/A, or its own units]: an insulator has it, and the 32 bits of a
converter do not count to it."""


def impossible(frames: Array) -> NDArray[np.intp]:
    """The rows of `frames` (n, M) that hold a value that is no number, or `MAX_VALUE` and more."""
    return np.flatnonzero(~(np.abs(frames) < MAX_VALUE).all(axis=1))


def peak(frame: Array) -> str:
    """The impossible value of a frame (M,), and what is possible, to be said in a sentence."""
    wrong = int(np.argmin(np.abs(frame) < MAX_VALUE))
    if not np.isfinite(frame[wrong]):
        return f"{frame[wrong]} as value {wrong}, which is no number"
    return f"{frame[wrong]:.3g} V/A as value {wrong}, where less than {MAX_VALUE:.0e} is possible"
