"""Frames of a file whose order is not known: any array with as many columns as an order has."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from eitbench.hardware.recording.importing.sources import is_own, own_content, read_arrays
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings.fetch import no_untouched_frame
from eitbench.scenarios.recordings.files.own import (
    frames_of_touches,
    has_reference,
    untouched_rows,
)
from eitbench.scenarios.wiring.touches import Touches, touches_of


def unordered_frames(path: Path, lengths: Collection[int]) -> Array:
    """Frames (n, M) of the file at `path`, where M is one of `lengths`; of complex ones Re.

    Of a recording its frames of the untouched sensor, or all where none are marked.

    Raises:
        InputError: no array of such a length, or several.
        UnreadableError, DataCorruptError: as `read_arrays`.
    """
    if is_own(path):
        content = own_content(path)
        if content.differences:
            raise no_untouched_frame(path)
        untouched = untouched_rows(content)
        return content.values[untouched] if len(untouched) else content.values
    found: dict[bytes, Array] = {}
    shapes = []
    for array in read_arrays(path).values():
        numbers = np.asarray(array)
        if numbers.dtype.kind not in "iufc" or numbers.ndim not in (1, 2):
            continue
        shapes.append(" x ".join(map(str, numbers.shape)))
        values = np.real(np.atleast_2d(numbers)).astype(np.float64)
        if values.shape[1] not in lengths and values.shape[0] in lengths:
            values = values.T
        if values.shape[1] in lengths:
            found.setdefault(values.tobytes(), values)
    wanted = ", ".join(map(str, sorted(lengths)))
    if not found:
        raise InputError(
            f"{path} holds no table of {wanted} values a frame, which the orders of this sensor "
            f"have, but {', '.join(shapes) or 'no'} numbers: name the sensor whose pattern the "
            "board measures, or give a file of its frames."
        )
    if len(found) > 1:
        raise InputError(
            f"{path} holds {len(found)} tables of {wanted} values a frame: keep the frames of the "
            "untouched sensor alone in a file."
        )
    (values,) = found.values()
    return values


def labelled_touches(path: Path) -> Touches | None:
    """Touches of a recording of our own whose places and reference frames are marked, or None."""
    if not is_own(path):
        return None
    content = own_content(path)
    marked = has_reference(content)
    return touches_of(frames_of_touches(content)) if len(content.labels) and marked else None
