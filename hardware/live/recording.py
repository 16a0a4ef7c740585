"""Recording beside the live view: an error of the file ends the recording, and nothing else."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.guided import Timing
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.errors import EitbenchError

SAME_PLACE_M = 1e-3
"""A hand that holds still moves no farther [m]."""


@dataclass
class _Touch:
    """A touch that goes on: its place [m], since when [s], and the rows that show it."""

    x_m: float
    y_m: float
    since_s: float
    first: int | None = None
    last: int = 0


class LiveRecording:
    """A file that is being written.

    Attributes:
        path: the file.
        frames: frames that were handed to it.
        touches: touches that were labelled.
        has_reference: frames of the untouched sensor were marked.
        failed: why it ended before it was told to; "" if it did not.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.path = recorder.path
        self.frames = 0
        self.touches = 0
        self.has_reference = False
        self.failed = ""
        self._touch: _Touch | None = None
        self._recorder: Recorder | None = recorder
        self._lock = threading.Lock()

    @property
    def running(self) -> bool:
        """Whether frames are still written."""
        return self._recorder is not None and not self.failed

    def append(self, frame: Frame) -> None:
        """Have `frame` written, if the recording runs."""

        def append(recorder: Recorder) -> None:
            recorder.append(frame)
            touch = self._touch
            if touch is not None and frame.received_s >= touch.since_s + Timing.settle_s:
                touch.first = self.frames if touch.first is None else touch.first
                touch.last = self.frames
            self.frames += 1

        self._tell(append)

    def event(self, text: str, time_s: float) -> None:
        """Have an event written, if the recording runs."""
        self._tell(lambda recorder: recorder.event(text, time_s))

    def mark_reference(self, count: int) -> None:
        """Have it written that the last `count` frames show the untouched sensor."""
        if self.frames >= count:
            self._tell(
                lambda recorder: recorder.mark_reference(self.frames - count, self.frames - 1)
            )
            self.has_reference = True

    def touched(self, x_m: float, y_m: float) -> None:
        """The sensor is touched at (x, y) [m], until `released` or touched elsewhere."""

        def touch(recorder: Recorder) -> None:
            of = self._touch
            if of is None or math.hypot(x_m - of.x_m, y_m - of.y_m) > SAME_PLACE_M:
                self._label(recorder)
                self._touch = _Touch(x_m, y_m, time.monotonic())

        self._tell(touch)

    def released(self) -> None:
        """It is touched no more: what was held long enough to settle is labelled."""
        self._tell(self._label)

    def _label(self, recorder: Recorder) -> None:
        touch, self._touch = self._touch, None
        if touch is not None and touch.first is not None:
            state = f"{1e3 * touch.x_m:.1f} {1e3 * touch.y_m:.1f}"
            recorder.label(touch.first, touch.last, x_m=touch.x_m, y_m=touch.y_m, state=state)
            self.touches += 1

    def close(self) -> None:
        """Have the rest written; no error if it is closed."""
        self.released()
        with self._lock:
            recorder, self._recorder = self._recorder, None
        if recorder is not None:
            self._guard(recorder.close)

    def _tell(self, what: Callable[[Recorder], None]) -> None:
        # The file must not be closed in between; that a frame waits for this takes no time.
        with self._lock:
            recorder = self._recorder
            if recorder is not None and not self.failed:
                self._guard(lambda: what(recorder))

    def _guard(self, write: Callable[[], None]) -> None:
        try:
            write()
        except Exception as error:  # the board and the view go on
            if not self.failed:
                known = isinstance(error, EitbenchError)
                self.failed = str(error) if known else f"{self.path} cannot be written: {error}."
