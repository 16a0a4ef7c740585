"""Recording beside the view: a thread that nothing waits for writes every frame to a file."""

import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from eitbench.hardware.board import Frame
from eitbench.scenarios.errors import EitbenchError
from eitbench.scenarios.sensors import Sensor

# A disk that stands still for this many frames (80 s at 100 a second, 14 MB) ends the recording.
MOST_WAITING = 8192
_WAIT_S = 0.05


class Recorder(Protocol):
    """A file that frames are appended to."""

    def append(self, frame: Frame) -> None:
        """Write a frame."""

    def event(self, text: str, time_s: float) -> None:
        """Write what happened, and when."""

    def close(self) -> None:
        """Write what is left."""


MakeRecorder = Callable[[Path, Sensor, str], Recorder]
"""From the path of a new file, the sensor and the board's name."""


class Recording:
    """One file that is being written.

    Attributes:
        path: the file.
        failed: why it ended before it was told to; "" if it did not.
        frames: frames that were written so far.
    """

    def __init__(self, path: Path, make: Callable[[], Recorder]) -> None:
        self.path = path
        self.failed = ""
        self.frames = 0
        self._recorder = make()
        self._waiting: queue.Queue[Callable[[], None]] = queue.Queue(MOST_WAITING)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._write, name="eitbench-recording", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether frames are still written."""
        return self._thread.is_alive() and not self.failed

    def append(self, frame: Frame) -> None:
        """Have `frame` written; returns at once."""

        def write() -> None:
            self._recorder.append(frame)
            self.frames += 1

        self._put(write)

    def event(self, text: str, time_s: float) -> None:
        """Have `text` written as an event at `time_s` [s]; returns at once."""
        self._put(lambda: self._recorder.event(text, time_s))

    def close(self) -> None:
        """Write what is waiting, and end; returns when the file is closed."""
        self._ended.set()
        self._thread.join()

    def _put(self, write: Callable[[], None]) -> None:
        if self._ended.is_set() or self.failed:
            return
        try:
            self._waiting.put_nowait(write)
        except queue.Full:
            self.failed = f"{self.path} cannot be written as fast as frames come: it ends here."

    def _next(self) -> Callable[[], None] | None:
        while True:
            try:
                return self._waiting.get(timeout=_WAIT_S)
            except queue.Empty:
                if self._ended.is_set():
                    return None

    def _write(self) -> None:
        try:
            while not self.failed and (write := self._next()) is not None:
                write()
        except Exception as error:  # a full disk ends the recording, never the view
            self._fail(error)
        try:
            self._recorder.close()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if not self.failed:
            known = isinstance(error, EitbenchError)
            self.failed = str(error) if known else f"{self.path} cannot be written: {error}."
