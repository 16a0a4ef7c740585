"""Measurements of a reference frame that no touch can be read from: dead and saturated ones."""

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.sensors.patterns import DrivePattern

SILENT = 0.1
"""Size of an electrode's measurements over that of a typical electrode, both relative to the
model's, below which it has no contact."""
SATURATED = 10.0
"""A value so many times as large as the others, relative to the model's, is none of the sensor: an
amplifier saturates, or an input floats. The unevenest skin that works has 7.5 (`ohmc8`)."""


def dead_electrodes(reference: Array, modelled: Array, pattern: DrivePattern) -> NDArray[np.bool_]:
    """(..., E): electrodes that drive and sense next to nothing in frames (..., M).

    Args:
        reference: frames of the untouched sensor, in any units.
        modelled: (M,) the model's.
        pattern: which electrodes each value drives and senses with.
    """
    taking_part = _taking_part(pattern)
    expected = np.sqrt(taking_part @ modelled**2)
    size = np.sqrt(reference**2 @ taking_part.T) / np.where(expected > 0, expected, np.inf)
    typical = np.median(size[..., expected > 0], axis=-1, keepdims=True)
    return np.asarray((size < SILENT * typical) & (expected > 0))


def spoiled(reference: Array, modelled: Array, pattern: DrivePattern) -> NDArray[np.bool_]:
    """(..., M): values of frames (..., M) that a dead electrode or saturation spoils.

    A dead electrode spoils all that is driven or sensed with it.
    """
    dead = dead_electrodes(reference, modelled, pattern) @ _taking_part(pattern) > 0
    # Where the model's value is near 0, a large ratio says nothing.
    size = np.abs(modelled)
    ratio = np.abs(reference) / np.maximum(size, np.median(size))
    typical = np.nanmedian(np.where(dead, np.nan, ratio), axis=-1, keepdims=True)
    return np.asarray(dead | (ratio > SATURATED * typical))


def _taking_part(pattern: DrivePattern) -> Array:
    """(E, M): 1 where an electrode drives or senses."""
    electrodes = np.arange(pattern.table.max() + 1)
    return (pattern.table == electrodes[:, None, None]).any(axis=2).astype(np.float64)
