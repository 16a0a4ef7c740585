"""Recording beside the live view: an error of the file ends the recording, and nothing else."""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from eitbench.hardware.board import Frame
from eitbench.hardware.recording.guided import StepDurations
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.errors import EitbenchError

SAME_PLACE_M = 1e-3
"""A hand that holds still moves no farther [m]."""


@dataclass
class _Touch:
    """A touch under way: its place [m], its begin [s], and the rows that show it."""

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
        has_reference: reference frames were marked.
        places: of the touches that were labelled [m].
        failed: reason why it ended early; "" if it did not.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.path = recorder.path
        self.frames = 0
        self.has_reference = False
        self.places = list[tuple[float, float]]()
        self._refused: tuple[int, int] | None = None
        self.failed = ""
        self._touch: _Touch | None = None
        self._recorder: Recorder | None = recorder
        self._closed = False
        self._lock = threading.Lock()

    @property
    def running(self) -> bool:
        """True until the file is whole and closed, or has failed."""
        return not self._closed and not self.failed

    @property
    def touching(self) -> bool:
        """True while a touch is recorded."""
        return self.running and self._touch is not None

    def append(self, frame: Frame) -> None:
        """Write `frame`, if the recording runs."""

        def append(recorder: Recorder) -> None:
            recorder.append(frame)
            touch = self._touch
            if touch is not None and frame.received_s >= touch.since_s + StepDurations.settle_s:
                touch.first = self.frames if touch.first is None else touch.first
                touch.last = self.frames
            self.frames += 1

        self._write(append)

    def event(self, text: str, time_s: float) -> None:
        """Write an event, if the recording runs."""
        self._write(lambda recorder: recorder.event(text, time_s))

    def mark_reference(self, count: int, *, refused: bool = False) -> None:
        """Mark the last `count` frames as reference frames.

        Args:
            count: number of frames.
            refused: images cannot be made with them: they are marked at the end, if no others were.
        """
        if self.frames < count:
            return
        rows = self.frames - count, self.frames - 1
        if refused:
            self._refused = rows
        else:
            self._write(lambda recorder: recorder.mark_reference(*rows))
            self.has_reference = True

    def touched(self, x_m: float, y_m: float) -> None:
        """Begin a touch at (x, y) [m]; it lasts until `released` or a touch elsewhere."""

        def touch(recorder: Recorder) -> None:
            of = self._touch
            if of is None or math.hypot(x_m - of.x_m, y_m - of.y_m) > SAME_PLACE_M:
                self._label(recorder)
                self._touch = _Touch(x_m, y_m, time.monotonic())

        self._write(touch)

    def released(self) -> None:
        """End the touch; it is labelled if it lasted long enough to settle."""
        self._write(self._label)

    def _label(self, recorder: Recorder) -> None:
        touch, self._touch = self._touch, None
        if touch is not None and touch.first is not None:
            state = f"{1e3 * touch.x_m:.1f} {1e3 * touch.y_m:.1f}"
            recorder.label(touch.first, touch.last, x_m=touch.x_m, y_m=touch.y_m, state=state)
            self.places.append((touch.x_m, touch.y_m))

    def close(self) -> None:
        """Write the rest and close the file; no error if it is closed."""
        self.released()
        if self._refused is not None and not self.has_reference:
            # A reversed sign, say, can be mended later: these frames show no touch all the same.
            first, last = self._refused
            self._write(lambda recorder: recorder.mark_reference(first, last))
            self.has_reference = True
        with self._lock:
            recorder, self._recorder = self._recorder, None
        if recorder is not None:
            self._guard(recorder.close)
        self._closed = True

    def _write(self, what: Callable[[Recorder], None]) -> None:
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
