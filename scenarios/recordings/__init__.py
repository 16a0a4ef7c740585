"""Recorded sensor sets, public and own: descriptors, readers and verified downloads."""

from eitbench.scenarios.recordings.descriptors import RecordedFrames, RecordedSet
from eitbench.scenarios.recordings.fetch import fetch_recording, read_recording
from eitbench.scenarios.recordings.files.own import is_recording
from eitbench.scenarios.recordings.registry import RECORDED_SETS, recorded_set

__all__ = [
    "RECORDED_SETS",
    "RecordedFrames",
    "RecordedSet",
    "fetch_recording",
    "is_recording",
    "read_recording",
    "recorded_set",
]
