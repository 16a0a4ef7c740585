"""Recordings of boards: free or guided, exported, imported."""

from eitbench.hardware.recording.guided import GuidedSession
from eitbench.hardware.recording.loop import record
from eitbench.hardware.recording.recorder import Recorder, RecorderError

__all__ = ["GuidedSession", "Recorder", "RecorderError", "record"]
