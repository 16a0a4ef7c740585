"""RecordedFrames a board: every frame into a file, through unplugging and plugging in again."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Event

from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame
from eitbench.hardware.emulation.emulator import Emulator
from eitbench.hardware.emulation.replay import Replay
from eitbench.hardware.recording.recorder import Recorder
from eitbench.hardware.recording.status import Monitor, Status
from eitbench.hardware.serial.serial_board import SerialBoard

WAIT_S = 0.1
"""How long the board is waited for before a stop or the end of time is looked at."""
STATUS_S = 0.5
"""Time between two statuses."""
AGAIN_S = 0.5
"""Time between two attempts to open a board that went away."""


class Continuity:
    """Keeps numbers and times of frames growing when a board starts anew.

    A board that was unplugged counts from zero again. Its frames are numbered on from the last one
    before, and its clock is set so that it agrees with the time between their receptions.
    """

    def __init__(self) -> None:
        self._last: Frame | None = None
        self._number, self._time_s = 0, 0.0
        self._anew = False

    def restart(self) -> None:
        """The next frame is the first after a break."""
        self._anew = self._last is not None

    def __call__(self, frame: Frame) -> Frame:
        """`frame` with a number and a time that follow on those before."""
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


def is_emulated(board: Board) -> bool:
    """Whether no real sensor is measured: an emulated board, its recording, or a pseudo-terminal.

    What is on a pseudo-terminal is taken for emulated, whatever it says of itself.
    """
    if isinstance(board, SerialBoard):
        return Path(board.port).resolve().is_relative_to("/dev/pts")
    return isinstance(board, Emulator) or (isinstance(board, Replay) and board.emulated)


def record(
    board: Board,
    recorder: Recorder,
    *,
    seconds: float | None = None,
    stop: Event | None = None,
    show: Callable[[Status], None] = lambda status: None,
    say: Callable[[str], None] = lambda sentence: None,
) -> Status:
    """Record the open `board` for `seconds`, until `stop` is set, or until a replay has ended.

    A board that goes away is waited for, which is noted as an event and said.

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
        BoardError: the board sends something else than its frames.
        RecorderError: the file cannot be written.
    """
    stop = stop or Event()
    monitor, follow = Monitor(board.sensor), Continuity()
    now = time.monotonic()
    end_s, shown_s = float("inf") if seconds is None else now + seconds, now
    damaged_before = 0

    def over() -> bool:
        ended = isinstance(board, Replay) and board.ended
        return stop.is_set() or time.monotonic() >= end_s or ended

    board.start()
    try:
        while not over():
            try:
                arrived = [follow(frame) for frame in board.frames(WAIT_S)]
            except BoardLostError as lost:
                damaged_before += board.health.damaged
                _note(recorder, say, f"{lost} Waiting for it to return.")
                if _returned(board, over):
                    follow.restart()
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
    """Whether the board could be opened and started again before all was `over`."""
    while not over():
        board.close()
        try:
            board.open()
            board.start()
        except BoardError:
            time.sleep(AGAIN_S)
        else:
            return True
    return False
