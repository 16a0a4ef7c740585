"""Recording beside the view: what goes wrong with the file ends the recording, and nothing else."""

import threading
from collections.abc import Callable

from eitbench.hardware.board import Frame
from eitbench.hardware.recorder import Recorder
from eitbench.scenarios.errors import EitbenchError


class Recording:
    """A file that is being written.

    Attributes:
        path: the file.
        frames: frames that were handed to it.
        failed: why it ended before it was told to; "" if it did not.
    """

    def __init__(self, recorder: Recorder) -> None:
        self.path = recorder.path
        self.frames = 0
        self.failed = ""
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
            self.frames += 1

        self._tell(append)

    def event(self, text: str, time_s: float) -> None:
        """Have an event written, if the recording runs."""
        self._tell(lambda recorder: recorder.event(text, time_s))

    def untouched(self, count: int) -> None:
        """Have it written that the last `count` frames show the untouched sensor."""
        if self.frames >= count:
            self._tell(lambda recorder: recorder.untouched(self.frames - count, self.frames - 1))

    def close(self) -> None:
        """Have the rest written; no error if it is closed."""
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
