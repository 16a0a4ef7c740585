"""Record a board, through unplugging and plugging in again, and follow its status."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from threading import Event

import numpy as np

from eitbench.hardware.board import Board, BoardError, BoardLostError, Frame
from eitbench.hardware.recording.recorder import Recorder
from eitbench.scenarios.recordings.frames import impossible
from eitbench.scenarios.recordings.quality import (
    frame_noise,
    reciprocity_error,
    suspect_electrodes,
)
from eitbench.scenarios.sensors.sensor import Sensor

WINDOW = 50
"""Frames, the last ones, that a status is computed from."""
_NAMED = 2  # suspects in a line


@dataclass(frozen=True)
class Status:
    """A recording at a moment.

    Attributes:
        frames: frames so far.
        rate_hz: frames per second; NaN before the second one.
        snr_db: rms of the running reference (the mean of the last frames) over the rms of their
            noise [dB]; NaN before the second frame, infinite without noise.
        dropped: frames that the board's running numbers show to be missing.
        damaged: frames with a wrong checksum, or cut short.
        reciprocity: relative reciprocity error of the running reference; NaN where nothing is
            measured twice.
        suspects: electrodes that seem to have no contact, or too much noise.
    """

    frames: int
    rate_hz: float
    snr_db: float
    dropped: int
    damaged: int
    reciprocity: float
    suspects: tuple[int, ...]

    def line(self) -> str:
        """The status in one line of at most 80 characters; what is not known yet is a dash."""
        named, more = self.suspects[:_NAMED], len(self.suspects) - _NAMED
        suspects = ",".join(map(str, named)) + (f"+{more}" if more > 0 else "")
        return (
            f"{self.frames} frames {_or_dash(self.rate_hz, '.1f')}/s  "
            f"SNR {_or_dash(self.snr_db, '.0f')} dB  "
            f"{self.dropped} lost  {self.damaged} bad  "
            f"recip. {_or_dash(100 * self.reciprocity, '.1f')}%  "
            f"suspect {suspects or '-'}"
        )


def _or_dash(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


class Monitor:
    """Follows the frames of a board on `sensor`."""

    def __init__(self, sensor: Sensor) -> None:
        self._pattern = sensor.pattern
        self._last: deque[Frame] = deque(maxlen=WINDOW)
        self._frames = self._dropped = 0

    def add(self, frames: Sequence[Frame]) -> None:
        """More frames have arrived."""
        for frame in frames:
            if self._last:
                self._dropped += max(frame.number - self._last[-1].number - 1, 0)
            self._last.append(frame)
            self._frames += 1

    def status(self, damaged: int, now_s: float) -> Status:
        """The status at `now_s`, with the number of `damaged` frames that the board has counted.

        Args:
            now_s: on the clock of `Frame.received_s` [s].
        """
        reciprocity, snr_db = float("nan"), float("nan")
        suspects: tuple[int, ...] = ()
        values = np.array([frame.values for frame in self._last])
        if len(values):
            # Impossible frames say nothing about noise or contacts.
            values = np.delete(values, impossible(values), axis=0)
        if len(values):
            reference = values.mean(axis=0)
            if len(self._pattern.reciprocal_pairs()) and reference.any():
                reciprocity = float(reciprocity_error(reference, self._pattern))
            suspects = suspect_electrodes(values, self._pattern)
            noise = frame_noise(values)
            with np.errstate(divide="ignore"):
                snr_db = float(20 * np.log10(np.sqrt(np.mean(reference**2)) / noise))
        return Status(
            self._frames,
            self._rate_hz(now_s),
            snr_db,
            self._dropped,
            damaged,
            reciprocity,
            suspects,
        )

    def _rate_hz(self, now_s: float) -> float:
        if len(self._last) < 2:
            return float("nan")
        steps, first_s = len(self._last) - 1, self._last[0].received_s
        seconds = self._last[-1].received_s - first_s
        # The next frame may still be on its way; where it is late, fewer come than before.
        seconds = max(seconds, now_s - first_s - seconds / steps)
        return steps / seconds if seconds > 0 else float("nan")


WAIT_S = 0.1
"""Longest wait for frames before `stop` and the end of the time are looked at [s]."""
STATUS_S = 0.5
"""Time between two statuses [s]."""
RETRY_S = 0.5
"""Time between two attempts to open a board that went away [s]."""


class FrameRenumbering:
    """Numbers and times of frames that go on growing when a board starts anew.

    A board that was unplugged, or that starts anew by itself, counts from zero again. Its frames
    are numbered on from the last one before, and its clock is set so that it agrees with the time
    between their receptions.
    """

    def __init__(self) -> None:
        self._last: Frame | None = None
        self._number, self._time_s = 0, 0.0
        self._sent = -1  # the last number, as the board sent it
        self._anew = False

    def restart(self) -> None:
        """Expect the first frame after a break."""
        self._anew = self._last is not None

    def __call__(self, frame: Frame) -> Frame:
        """Return `frame` with a number and a time that follow those before."""
        self._anew |= frame.number < self._sent
        self._sent = frame.number
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
                damaged = board.health.damaged
                _note(recorder, say, f"{lost} Waiting for it to return.")
                if _returned(board, over, partial(_note, recorder, say)):
                    damaged_before += damaged  # it counts anew
                    renumber.restart()
                    _note(recorder, say, "The board is back.")
                continue
            for frame in arrived:
                recorder.append(frame)
            monitor.add(arrived)
            if time.monotonic() - shown_s >= STATUS_S:
                shown_s = time.monotonic()
                show(monitor.status(damaged_before + board.health.damaged, shown_s))
    finally:
        with suppress(BoardError):
            board.stop()
    return monitor.status(damaged_before + board.health.damaged, time.monotonic())


def _note(recorder: Recorder, say: Callable[[str], None], sentence: str) -> None:
    recorder.event(sentence, time.monotonic())
    say(sentence)


def _returned(board: Board, over: Callable[[], bool], tell: Callable[[str], None]) -> bool:
    """Open and start the board again; True if that succeeded before all was `over`.

    `tell` gets a sentence where it is there again, and something else is wrong with it. Once may
    be before the system has given us the right to use it.
    """
    before = told = ""
    while not over():
        board.close()
        try:
            board.open()
            board.start()
        except BoardError as error:
            if str(error) == before != told and not isinstance(error, BoardLostError):
                told = before
                tell(told)
            before = str(error)
            time.sleep(RETRY_S)
        else:
            return True
    return False
