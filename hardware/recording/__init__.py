"""Recordings of boards: free or guided, exported, imported."""

from typing import TYPE_CHECKING

from eitbench.scenarios.lazy import lazy_names

if TYPE_CHECKING:
    from eitbench.hardware.recording.exchange import export_recording, import_recording
    from eitbench.hardware.recording.guided import GuidedSession
    from eitbench.hardware.recording.loop import record
    from eitbench.hardware.recording.recorder import Recorder, RecorderError

__all__ = [
    "GuidedSession",
    "Recorder",
    "RecorderError",
    "export_recording",
    "import_recording",
    "record",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "GuidedSession": "guided",
        "Recorder": "recorder",
        "RecorderError": "recorder",
        "export_recording": "exchange",
        "import_recording": "exchange",
        "record": "loop",
    },
)
