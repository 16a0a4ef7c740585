"""A live session: the threads between a board, a file and the pages that are open.

One thread reads the board. Every frame goes to the recording, if there is one; only the newest goes
on to the images. A board that is lost is opened again every second until it is back.
"""

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from eitbench.hardware.board import Board, BoardError, Frame
from eitbench.hardware.live.imaging import REFERENCE_FRAMES, Imaging, reference_of, sentence_of
from eitbench.hardware.live.live_recording import LiveRecording
from eitbench.hardware.live.viewer import LiveImage
from eitbench.hardware.recording.guided import (
    MIN_TOUCHES,
    registration_lacks,
    suite_path,
    write_suite,
)
from eitbench.hardware.recording.loop import FrameRenumbering, Monitor
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError

RETRY_S = 1.0
SILENT_S = 3.0
STATUS_S = 0.5
_WAIT_S = 0.1


class Session:
    """A board that is watched.

    Attributes:
        board: the board.
        name: the board's name.
        imaging: what makes images of its frames.
    """

    def __init__(
        self,
        board: Board,
        name: str,
        *,
        out: Path,
        show: Callable[[LiveImage], None],
        parameters: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        """Call `show` with every live image, from the thread that makes them; it must not wait.

        `parameters` are those of the methods' constructors, by name.
        """
        self.board = board
        self.name = name
        self.imaging = Imaging(board.sensor, show, parameters)
        self._out = out
        self._monitor, self._renumber = Monitor(board.sensor), FrameRenumbering()
        self._status, self._status_s = self._monitor.status(0, 0.0), -STATUS_S
        self._damaged_before = 0
        self._recording: LiveRecording | None = None
        self._recording_lock = threading.Lock()
        self._lost = ""
        self._reference_frames: list[Array] | None = []
        self._reference_failed = ""
        self._last_frame_s = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, name="eitbench-board", daemon=True)

    def start(self, method: str) -> None:
        """Open the board and begin.

        Raises:
            BoardError: it cannot be opened.
            InputError: an unknown method, or one that cannot be used on the sensor.
        """
        self.imaging.choose(method)
        self.board.open()
        try:
            self.board.start()
            self.imaging.start()
            self._thread.start()
        except BaseException:  # also Ctrl-C
            self._ended.set()
            self.board.close()
            raise

    def stop(self) -> None:
        """End the recording and let go of the board."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
            self.imaging.stop()
        self.stop_recording()

    def take_reference(self) -> None:
        """Take the mean of the next frames as the reference frame.

        Raises:
            InputError: a touch is being recorded.
        """
        if self._recording is not None and self._recording.touching:
            raise InputError("Let go first: a touch is being recorded.")
        self._reference_failed = ""
        self._reference_frames = []

    def start_recording(self) -> None:
        """Write frames to a new file from now on, the reference first.

        Raises:
            EitbenchError: the file cannot be made, or a recording is under way.
        """
        with self._recording_lock:
            if self._recording is not None and self._recording.running:
                raise InputError(f"A recording is under way: {self._recording.path.name}.")
            path = self._out / f"live-{time.strftime('%Y%m%d-%H%M%S')}.h5"
            self._close_recording()  # one that failed
            self._recording = LiveRecording(
                Recorder(
                    path,
                    self.board.sensor,
                    self.name,
                    firmware=self.board.firmware,
                    emulated=self.board.emulated,
                )
            )
        self.take_reference()

    def stop_recording(self) -> None:
        """Close the file, a suite beside it if it has touches; nothing if none is written."""
        with self._recording_lock:
            self._close_recording()

    def touch(self, x_m: float, y_m: float, radius_m: float, pressure_pa: float | None) -> None:
        """Press an emulated sensor; of any, note in the recording where it is touched.

        Raises:
            InputError: a place off the sensor, which ends the touch; the board is real and
                nothing is recorded; or a recording takes its reference.
        """
        try:
            self.board.sensor.check_place(x_m, y_m)
        except InputError:
            self.release()
            raise
        recording = self._recording
        if recording is not None and recording.running and self._reference_frames is not None:
            raise InputError("Do not touch it yet: the recording takes its reference.")
        if self.board.can_be_pressed and pressure_pa is not None:
            self.board.press(x_m, y_m, radius_m, pressure_pa)
        elif recording is None or not recording.running:
            raise InputError("Start a recording first: it keeps the places where you touch.")
        if recording is not None:
            recording.touched(x_m, y_m)

    def release(self) -> None:
        """End the touch."""
        self.board.release()
        if self._recording is not None:
            self._recording.released()

    def state(self) -> dict[str, object]:
        """State of board, method and recording, as plain values."""
        recording, status = self._recording, self._status
        scored = (
            recording is not None
            and recording.has_reference
            and not registration_lacks(recording.places)
        )
        taken, board = self._reference_frames, self._board_state()
        return {
            "board": board,
            "sentence": self._lost or self._reference_failed,
            "method": self.imaging.method,
            "fitting": self.imaging.fitting,
            "method_failed": self.imaging.failed,
            # With its last frame it is not there yet.
            "reference_left": 0 if taken is None else max(REFERENCE_FRAMES - len(taken), 1),
            "rate_hz": _known(status.rate_hz) if board == "running" else 0.0,
            "snr_db": _known(status.snr_db),
            "dropped": status.dropped,
            "damaged": status.damaged,
            "reciprocity": _known(status.reciprocity),
            "suspects": list(status.suspects),
            "recording": None
            if recording is None
            else {
                "file": str(recording.path),
                "running": recording.running,
                "frames": recording.frames,
                "touches": len(recording.places),
                "enough": MIN_TOUCHES,
                "suite": str(recording.path.with_suffix(".toml")) if scored else "",
                "failed": recording.failed,
            },
        }

    def _close_recording(self) -> None:
        recording = self._recording
        if recording is None:
            return
        was_running = recording.running
        recording.close()
        if was_running and recording.places and recording.has_reference and not recording.failed:
            path, sensor = recording.path, self.board.sensor
            try:
                write_suite(suite_path(path), path, sensor, self.name, emulated=self.board.emulated)
            except OSError as error:
                recording.failed = f"The suite of {path} cannot be written: {error.strerror}."

    def _board_state(self) -> str:
        if self._lost:
            return "lost"
        if time.monotonic() - self._last_frame_s > SILENT_S:
            return "silent"
        return "running"

    def _read(self) -> None:
        while not self._ended.is_set():
            try:
                if self._lost:
                    self.board.open()
                    self.board.start()
                    self._last_frame_s = time.monotonic()
                    self._renumber.restart()
                    self._note("The board is back.")
                    self._lost = ""
                while not self._ended.is_set():
                    self._add([self._renumber(frame) for frame in self.board.frames(_WAIT_S)])
            except Exception as error:  # anything else would leave a page that stands still
                self.board.close()
                self._lose(error)
                self._ended.wait(RETRY_S)
        with suppress(BoardError):  # it may be lost
            self.board.stop()
        self.board.close()

    def _lose(self, error: Exception) -> None:
        sentence = sentence_of(error)
        if not self._lost:
            self._damaged_before += self.board.health.damaged
            self._note(f"The board was lost: {sentence}")
        self._lost = sentence

    def _add(self, frames: list[Frame]) -> None:
        now = time.monotonic()
        self._monitor.add(frames)
        if now >= self._status_s + STATUS_S:
            damaged = self._damaged_before + self.board.health.damaged
            self._status, self._status_s = self._monitor.status(damaged, now), now
        for frame in frames:
            self._last_frame_s = now
            if self._recording is not None:
                self._recording.append(frame)
            taken = self._reference_frames
            if taken is not None:
                taken.append(frame.values)
                if len(taken) == REFERENCE_FRAMES:
                    self._finish_reference(taken)
            self.imaging.add(frame)

    def _finish_reference(self, frames: list[Array]) -> None:
        try:
            self.imaging.reference = reference_of(self.board.sensor, frames)
        except InputError as error:
            self._reference_failed = str(error)
        if self._recording is not None:
            refused = bool(self._reference_failed)
            self._recording.mark_reference(REFERENCE_FRAMES, refused=refused)
        # Unless it was asked for again meanwhile.
        if self._reference_frames is frames:
            self._reference_frames = None

    def _note(self, text: str) -> None:
        if self._recording is not None:
            self._recording.event(text, time.monotonic())


def _known(figure: float) -> float | None:
    return round(figure, 4) if np.isfinite(figure) else None
