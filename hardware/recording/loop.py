"""Record a board: every frame into a file, through unplugging and plugging in again."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from threading import Event

from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame
from eitbench.hardware.recording.recorder import Recorder
from eitbench.hardware.recording.status import Monitor, Status

WAIT_S = 0.1
"""Longest wait for frames before `stop` and the end of the time are looked at [s]."""
STATUS_S = 0.5
"""Time between two statuses [s]."""
RETRY_S = 0.5
"""Time between two attempts to open a board that went away [s]."""


class FrameRenumbering:
    """Numbers and times of frames that go on growing when a board starts anew.

    A board that was unplugged counts from zero again. Its frames are numbered on from the last one
    before, and its clock is set so that it agrees with the time between their receptions.
    """

    def __init__(self) -> None:
        self._last: Frame | None = None
        self._number, self._time_s = 0, 0.0
        self._anew = False

    def restart(self) -> None:
        """Expect the first frame after a break."""
        self._anew = self._last is not None

    def __call__(self, frame: Frame) -> Frame:
        """Return `frame` with a number and a time that follow those before."""
        if self._anew and self._last is not None:
            passed_s = frame.received_s - self._last.received_s
            self._number = self._last.number + 1 - frame.number
            self._time_s = self._last.time_s + passed_s - frame.time_s
            self._anew = False
        if self._number or self._time_s:
            frame = replace(
                frame, number=frame.number + self._number, time_s=frame.time_s + self._time_s
            )
        self._last = frame
        return frame


def record(
    board: Board,
    recorder: Recorder,
    *,
    seconds: float | None = None,
    stop: Event | None = None,
    show: Callable[[Status], None] = lambda status: None,
    say: Callable[[str], None] = lambda sentence: None,
) -> Status:
    """Record the open `board` for `seconds`, until `stop` is set, or until the board has ended.

    A board that goes away is waited for; this is noted as an event and said.

    Args:
        board: open, not yet started.
        recorder: where its frames go; it is not closed here.
        seconds: how long [s]; without end by default.
        stop: ends it from another thread.
        show: called with a status twice a second.
        say: called with sentences on what happens.

    Returns:
        The last status.

    Raises:
        BoardError: the board sends other bytes than its frames.
        RecorderError: the file cannot be written.
    """
    stop = stop or Event()
    monitor, renumber = Monitor(board.sensor), FrameRenumbering()
    now = time.monotonic()
    end_s, shown_s = float("inf") if seconds is None else now + seconds, now
    damaged_before = 0

    def over() -> bool:
        return stop.is_set() or time.monotonic() >= end_s or board.ended

    board.start()
    try:
        while not over():
            try:
                arrived = [renumber(frame) for frame in board.frames(WAIT_S)]
            except BoardLostError as lost:
                damaged_before += board.health.damaged
                _note(recorder, say, f"{lost} Waiting for it to return.")
                if _returned(board, over):
                    renumber.restart()
                    _note(recorder, say, "The board is back.")
                continue
            for frame in arrived:
                recorder.append(frame)
            monitor.add(arrived)
            if time.monotonic() - shown_s >= STATUS_S:
                shown_s = time.monotonic()
                show(monitor.status(damaged_before + board.health.damaged))
    finally:
        with suppress(BoardError):
            board.stop()
    return monitor.status(damaged_before + board.health.damaged)


def _note(recorder: Recorder, say: Callable[[str], None], sentence: str) -> None:
    recorder.event(sentence, time.monotonic())
    say(sentence)


def _returned(board: Board, over: Callable[[], bool]) -> bool:
    """Open and start the board again; True if that succeeded before all was `over`."""
    while not over():
        board.close()
        try:
            board.open()
            board.start()
        except BoardError:
            time.sleep(RETRY_S)
        else:
            return True
    return False
