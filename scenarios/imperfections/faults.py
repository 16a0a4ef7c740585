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

    An electrode whose large values are all shared with a dead one is silent, too. So of the silent
    electrodes as few are dead as explain the silence: what is left without their values is not
    silent. One after another is taken, that first which leaves the fewest silent.

    Args:
        reference: frames of the untouched sensor, in any units.
        modelled: (M,) the model's.
        pattern: which electrodes each value drives and senses with.
    """
    taking_part = _taking_part(pattern)
    dead = _silent(reference, modelled, taking_part) < SILENT
    # One silent electrode alone is the dead one.
    for index in np.argwhere(dead.sum(axis=-1) > 1):
        frame = reference[tuple(index)]
        dead[tuple(index)] = _fewest(frame, modelled, taking_part)
    return np.asarray(dead)


def never_alone(dead: NDArray[np.bool_], pattern: DrivePattern) -> NDArray[np.bool_]:
    """(E,): electrodes, none of `dead` (E,), that drive and sense only together with a dead one.

    No value says whether they have contact.
    """
    taking_part = _taking_part(pattern)
    own = taking_part * ~(taking_part[dead] > 0).any(axis=0)
    return np.asarray(~dead & taking_part.any(axis=1) & ~own.any(axis=1))


def _silent(reference: Array, modelled: Array, taking_part: Array) -> Array:
    """(..., E): size of each electrode's values over the model's, and over a typical one's.

    inf where nothing is expected.
    """
    expected = np.sqrt(taking_part @ modelled**2)
    size = np.sqrt(reference**2 @ taking_part.T) / np.where(expected > 0, expected, np.inf)
    if not (expected > 0).any():
        return np.full(size.shape, np.inf)
    # Where a connector is off, most electrodes send exact zeros: a typical one is none of these.
    heard = np.where((expected > 0) & (size > 0), size, np.nan)
    some = np.isfinite(heard).any(axis=-1, keepdims=True)
    typical = np.nanmedian(np.where(some, heard, 0.0), axis=-1, keepdims=True)
    known = (expected > 0) & (typical > 0)
    return np.asarray(np.divide(size, typical, out=np.full(size.shape, np.inf), where=known))


def _fewest(frame: Array, modelled: Array, taking_part: Array) -> NDArray[np.bool_]:
    """(E,): the dead ones of several silent electrodes in a frame (M,)."""
    dead = np.zeros(len(taking_part), dtype=bool)

    def left(others: NDArray[np.bool_]) -> Array:
        return _silent(frame, modelled, taking_part * ~(taking_part[others] > 0).any(axis=0))

    while ((now := left(dead)) < SILENT).any():
        # Of two that leave as many the quieter one.
        ranks = {
            (int((left(dead | (np.arange(len(dead)) == k)) < SILENT).sum()), now[k]): k
            for k in np.flatnonzero(now < SILENT)
        }
        dead[ranks[min(ranks)]] = True
    return dead


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
