"""Touches that were measured as pairs of frames, released and pressed, or as their differences."""

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.files.csv_mat import without_times
from eitbench.scenarios.recordings.files.layout import LABEL_NUMBERS
from eitbench.scenarios.recordings.files.recording_file import Content, label_table
from eitbench.scenarios.sensors.sensor import Sensor

Frames = NDArray[np.float64]


def alternating(frames: Frames) -> tuple[Frames, Frames]:
    """Released and pressed frames, each (n, M), of `frames` (2 n, M) that alternate so.

    Raises:
        InputError: an odd number of frames.
    """
    if len(frames) % 2:
        raise InputError(
            f"Pairs are released, pressed, released, pressed ..., and there are {len(frames)} "
            "frames: an even number is needed."
        )
    return frames[::2], frames[1::2]


def from_pairs(
    released: Frames,
    pressed: Frames,
    sensor: Sensor,
    board: str,
    contacts: pd.DataFrame | None = None,
    *events: str,
) -> Content:
    """A recording of n touches, each with a frame (M,) of the untouched sensor before it.

    Args:
        released, pressed: (n, M).
        sensor: that was measured; `board` measured it.
        contacts: any columns of `LABEL_NUMBERS` and `state`, one row per touch in their order; with
            a column `touch` (number of the touch, from 0) one row per contact.
        events: sentences on where it comes from.

    Raises:
        InputError: unlike numbers of released and pressed frames, or of touches and `contacts`.
    """
    if released.shape != pressed.shape:
        raise InputError(
            f"Pairs need as many released frames as pressed ones, got {len(released)} and "
            f"{len(pressed)}."
        )
    values = np.stack([released, pressed], axis=1).reshape(2 * len(pressed), -1)
    touch, known = _contacts(contacts, len(pressed))
    before = {"reference_first": 2 * touch, "reference_last": 2 * touch}
    labels = label_table(2 * touch + 1, 2 * touch + 1, {**known, **before})
    return replace(without_times(values, sensor, board, *events), labels=labels)


def from_differences(
    differences: Frames,
    sensor: Sensor,
    board: str,
    contacts: pd.DataFrame | None = None,
    *events: str,
) -> Content:
    """A recording of n touches as differences (n, M), pressed minus released; else as `from_pairs`.

    Raises:
        InputError: `contacts` of another number of touches.
    """
    touch, known = _contacts(contacts, len(differences))
    noted = "differences only, pressed minus released: the reference is modelled"
    content = without_times(differences, sensor, board, noted, *events)
    return replace(content, labels=label_table(touch, touch, known), differences=True)


def _contacts(
    contacts: pd.DataFrame | None, n: int
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.generic]]]:
    """The touch (k,) of every contact, and what is known of it, by the names of labels."""
    if contacts is None:
        return np.arange(n), {}
    known = {
        name: contacts[name].to_numpy() for name in (*LABEL_NUMBERS, "state") if name in contacts
    }
    touch = np.arange(len(contacts))
    if "touch" in contacts:
        touch = contacts["touch"].to_numpy(np.int64)
    if not np.array_equal(np.unique(touch), np.arange(n)):
        raise InputError(
            f"There are {n} touches in the frames and {len(np.unique(touch))} in their labels: "
            "each touch needs its row, in their order."
        )
    return touch, known
