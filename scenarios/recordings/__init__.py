"""Recorded sensor sets, public and own: descriptors, readers and verified downloads."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names
from eitbench.scenarios.recordings.descriptors import RecordedFrames, RecordedSet
from eitbench.scenarios.recordings.files.own import is_recording
from eitbench.scenarios.recordings.registry import RECORDED_SETS, recorded_set

if TYPE_CHECKING:
    from eitbench.scenarios.recordings.fetch import fetch_recording, read_recording

__all__ = [
    "RECORDED_SETS",
    "RecordedFrames",
    "RecordedSet",
    "fetch_recording",
    "is_recording",
    "read_recording",
    "recorded_set",
]

# These look up the sets above.
__getattr__, __dir__ = lazy_names(__name__, {"fetch_recording": "fetch", "read_recording": "fetch"})
