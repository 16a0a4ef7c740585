"""The two scores that sum SSIM, CC, RIE and PSNR up: S as published, and the bounded B."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eitbench.benchmark.metrics.specs import ANCHORS

Array = NDArray[np.float64]


def score(ssim: ArrayLike, cc: ArrayLike, rie: ArrayLike, psnr: ArrayLike) -> Array:
    """Weighted score S = 0.25 (SSIM + CC + PSNR) - 0.25 RIE as published, with PSNR in dB."""
    total = np.asarray(ssim, float) + np.asarray(cc, float) + np.asarray(psnr, float)
    return np.asarray(0.25 * (total - np.asarray(rie, float)))


def anchored(figures: Mapping[str, ArrayLike]) -> Array:
    """SSIM, CC, RIE and PSNR (n,) between their `ANCHORS` as numbers from 0 to 1: (n, 4)."""
    columns = [
        (np.asarray(figures[name], float) - low) / (high - low)
        for name, (low, high) in ANCHORS.items()
    ]
    return np.stack(columns, axis=-1).clip(0.0, 1.0)


def bounded_score(figures: Mapping[str, ArrayLike]) -> Array:
    """Mean of SSIM, CC, RIE and PSNR (n,), each between its `ANCHORS`: (n,), from 0 to 1."""
    return np.asarray(anchored(figures).mean(axis=-1))
