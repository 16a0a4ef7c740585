"""Differences of neighbours from boards that report the potential of every electrode."""

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.sensors.patterns import DrivePattern

Drives = list[tuple[int, int]]
Index = NDArray[np.int64]


def in_phase_differences(
    potentials: NDArray[np.complex128], drives: Drives, pattern: DrivePattern
) -> NDArray[np.float64]:
    """Re(U[a] - U[b]) as (..., M) from potentials U (..., drives, electrodes).

    The in-phase part carries the resistive field; a model with real conductivity has no other.
    """
    drive, a, b = places(drives, pattern)
    return np.real(potentials[..., drive, a] - potentials[..., drive, b])


def places(drives: Drives, pattern: DrivePattern) -> tuple[Index, Index, Index]:
    """Indices of the values of a frame in an array (drives, electrodes): drives, a and b."""
    row = {drive: k for k, drive in enumerate(drives)}
    src, sink, a, b = pattern.table.T
    drive = [row[pair] for pair in zip(src.tolist(), sink.tolist(), strict=True)]
    return np.array(drive), a, b
