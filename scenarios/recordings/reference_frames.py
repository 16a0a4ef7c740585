"""Reference frames of a recording, public or one's own."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import recorded_set
from eitbench.scenarios.recordings.fetch import read_recording
from eitbench.scenarios.recordings.files.own import is_recording, undamaged
from eitbench.scenarios.sensors.sensor import Sensor


def reference_frames(name: str) -> tuple[Sensor, NDArray[np.float64]]:
    """The nominal sensor, and reference frames (n, M) in the board's units; of a public set one.

    Raises:
        InputError: unknown name, or a recording (.h5) without reference frames.
        DataUnavailableError, DataCorruptError: the data cannot be had, or are damaged.
    """
    if not is_recording(name):
        return recorded_set(name).sensor(), read_recording(name).reference[None]
    content, _ = undamaged(Path(name))
    if not len(content.reference):
        raise InputError(
            f"{name} marks no reference frames: record with --guided, or take a new reference "
            "on the live page while it records."
        )
    return content.sensor, content.values[content.reference]
