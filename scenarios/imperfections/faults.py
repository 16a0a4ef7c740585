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
    return _of_dead(reference, modelled, pattern) | saturated_values(reference, modelled, pattern)


def saturated_values(reference: Array, modelled: Array, pattern: DrivePattern) -> NDArray[np.bool_]:
    """(..., M): values of frames (..., M) that are far larger than the others, see `SATURATED`."""
    # Where the model's value is near 0, a large ratio says nothing.
    size = np.abs(modelled)
    ratio = np.abs(reference) / np.maximum(size, np.median(size))
    sound = np.where(_of_dead(reference, modelled, pattern), np.nan, ratio)
    return np.asarray(ratio > SATURATED * np.nanmedian(sound, axis=-1, keepdims=True))


def _of_dead(reference: Array, modelled: Array, pattern: DrivePattern) -> NDArray[np.bool_]:
    return np.asarray(dead_electrodes(reference, modelled, pattern) @ _taking_part(pattern) > 0)


def _taking_part(pattern: DrivePattern) -> Array:
    """(E, M): 1 where an electrode drives or senses."""
    electrodes = np.arange(pattern.table.max() + 1)
    return np.asarray((pattern.table == electrodes[:, None, None]).any(axis=2), dtype=np.float64)
