"""Reciprocity: measurements of a frame that repeat one another, and their means."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eitbench.scenarios.sensors.patterns import DrivePattern


def independent(
    pattern: DrivePattern,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Find the measurements that reciprocity leaves independent, and the map from them to all.

    Returns `first` (K,), the independent measurements' numbers, and `owner` and `sign` (M,), such
    that `v = v[first][owner] * sign`.
    """
    root, sign = np.arange(pattern.n_measurements), np.ones(pattern.n_measurements, np.float32)
    pairs = pattern.reciprocal_pairs()
    # In ascending order of the second, so that the first of a pair is resolved before it is used.
    for (earlier, later), pair_sign in zip(pairs, pattern.reciprocal_signs(pairs), strict=True):
        root[later] = root[earlier]
        sign[later] = sign[earlier] * pair_sign
    first, owner = np.unique(root, return_inverse=True)
    return first, owner, sign


def averaging(pattern: DrivePattern) -> NDArray[np.float64]:
    """(M, K): frames @ averaging are the independent values (K,), each the mean of its repetitions.

    The mean of two measurements has half of the variance of their noise.
    """
    first, owner, sign = independent(pattern)
    matrix = np.zeros((pattern.n_measurements, len(first)))
    matrix[np.arange(pattern.n_measurements), owner] = sign
    return np.asarray(matrix / np.bincount(owner))
