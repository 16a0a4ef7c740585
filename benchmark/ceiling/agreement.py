"""Whether samplers agree on a frame: R-hat of what it says of a touch, whatever its family."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.sensor import Sensor

TRACES = ("x", "y", "strength", "area")
"""What a frame says of a touch, whatever its family: the centre of its |contrast| [m], the integral
of its contrast [m^2], and its area [m^2]."""
AGREED = 1.01
"""Greatest R-hat of the traces of a frame whose draws are trusted."""
ROUNDING = 1e-9
"""Relative size of differences between traces that say nothing."""


def traces(conductivity: Array, sensor: Sensor) -> Array:
    """`TRACES` (n, 4) of images (n, H, W) [S/m]."""
    inside = sensor.mask
    contrast = 1 - conductivity[:, inside] / sensor.background
    strength, area = contrast.sum(axis=1), (contrast != 0).sum(axis=1)
    weight = np.abs(contrast)
    total = np.maximum(weight.sum(axis=1), 1e-12)
    x, y = (weight @ axis[inside] / total for axis in sensor.pixel_centres)
    pixel = np.prod(sensor.pixel_size)
    return np.stack([x, y, strength * pixel, area * pixel], axis=1)


def rhat(chains: Sequence[Array], weights: Sequence[Array]) -> float:
    """R-hat of one trace, from weighted draws (n,) of each chain (Gelman and Rubin 1992)."""
    means = [float(w @ x) for x, w in zip(chains, weights, strict=True)]
    within = [float(w @ (x - m) ** 2) for x, w, m in zip(chains, weights, means, strict=True)]
    between, rounding = float(np.var(means, ddof=1)), (ROUNDING * np.abs(means).max()) ** 2
    if np.mean(within) <= rounding:  # the same in all draws
        return 1.0 if between <= rounding else float("inf")
    return float(np.sqrt(1 + between / np.mean(within)))


def greatest_rhat(chains: Sequence[Array], weights: Sequence[Array]) -> float:
    """The greatest R-hat of several traces, from weighted draws (n, T) of each chain."""
    columns = zip(*(chain.T for chain in chains), strict=True)
    return max(rhat(column, weights) for column in columns)
