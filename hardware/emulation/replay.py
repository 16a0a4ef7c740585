"""A recording played back as if a board measured it now."""

import time
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from eitbench.hardware.board import Board, BoardError, Frame, Health
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.recordings import is_recording, recorded_set
from eitbench.scenarios.recordings.fetch import no_untouched_frame, read_recording
from eitbench.scenarios.recordings.files.own import undamaged, untouched_rows
from eitbench.scenarios.recordings.files.recording_file import Content
from eitbench.scenarios.sensors.sensor import Sensor

RATE_HZ = 10.0
"""Frames per second of a set that does not say when its frames were measured."""

_UNTOUCHED = 10  # times the reference of a set comes before its frames, as from an untouched sensor


class Replay(Board):
    """A recorded set or a recording, played back.

    A recorded set begins with a second of its reference, and so does a recording whose first frames
    are not marked as such. After its last frame no more come.

    Args:
        file: name of a recorded set, or the path of a recording (.h5).
        speed: times its own rate.
        sensor: the sensor that it must be of; any by default.

    Raises:
        InputError: an unknown set, a speed that is not above 0, or another sensor.
        DataUnavailableError, DataCorruptError: as in `read_recording` and `undamaged`.
    """

    default_sensor: ClassVar[str | None] = None
    options: ClassVar[frozenset[str]] = frozenset({"file", "speed"})

    def __init__(self, file: str | Path, speed: float = 1.0, sensor: Sensor | None = None) -> None:
        if not (np.isfinite(speed) and speed > 0):
            raise InputError(f"A recording is played at a speed above 0, got {speed:g}.")
        if is_recording(str(file)):
            nominal, numbers, times, values, emulated = _recording_file(Path(file))
        else:
            nominal, numbers, times, values, emulated = _recorded_set(str(file))
        if sensor is not None and sensor != nominal:
            raise InputError(
                f"{file} was measured on sensor {nominal.name!r}, not on {sensor.name!r}: leave "
                "out --sensor."
            )
        super().__init__(nominal, emulated=emulated)
        self._numbers, self._values = numbers, values
        self._times = (times - times[0]) / speed
        self._position = 0
        self._open = False
        self._begin: float | None = None  # when frame 0 was, or would have been, sent

    @property
    def ended(self) -> bool:
        """True if all frames were sent."""
        return self._position == len(self._values)

    def open(self) -> None:
        """Go to the beginning."""
        self._position = 0
        self.health = Health()
        self._open = True

    def start(self) -> None:
        """Play."""
        if not self._open:
            raise BoardError("The recording is not open: open it first.")
        if not self.ended:
            self._begin = time.monotonic() - float(self._times[self._position])

    def frames(self, wait_s: float) -> list[Frame]:
        """Return the frames that were due since the last call."""
        end = time.monotonic() + wait_s
        due = self._due()
        if not due and not self.ended and self._begin is not None:
            end = min(end, self._begin + float(self._times[self._position]))
        if not due:
            time.sleep(max(end - time.monotonic(), 0))
            due = self._due()
        return due

    def stop(self) -> None:
        """Pause."""
        self._begin = None

    def close(self) -> None:
        """Stop for good."""
        self._begin = None
        self._open = False

    def _due(self) -> list[Frame]:
        if self._begin is None:
            return []
        now = time.monotonic()
        until = int(np.searchsorted(self._times, now - self._begin, side="right"))
        due = [
            Frame(int(self._numbers[k]), float(self._times[k]), now, self._values[k])
            for k in range(self._position, until)
        ]
        self._position = max(self._position, until)
        self.health.frames = self._position
        return due


Frames = tuple[Sensor, NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], bool]
"""A sensor, running numbers (n,), times (n,) [s], values (n, M), and True if the sensor was
emulated."""


def _recorded_set(name: str) -> Frames:
    recorded = recorded_set(name)
    recording = read_recording(name)
    if recording.modelled_reference:
        raise no_untouched_frame(name)
    untouched = np.repeat(recording.reference[None], _UNTOUCHED, axis=0)
    values = np.concatenate([untouched, recording.voltages])
    numbers = np.arange(len(values))
    return recorded.sensor(), numbers, numbers / RATE_HZ, values, False


def _recording_file(path: Path) -> Frames:
    content, _ = undamaged(path)
    if not len(content):
        raise InputError(f"{path} holds no frames: there is nothing to play.")
    if content.differences:
        raise no_untouched_frame(path)
    numbers, times, values = _numbers(content), _clock(content), content.values
    untouched = untouched_rows(content)
    if len(untouched) and not np.isin(np.arange(_UNTOUCHED), untouched).all():
        # What shows images takes the first frames for the untouched sensor.
        before = np.arange(_UNTOUCHED)
        numbers = np.concatenate([before, numbers + _UNTOUCHED])
        times = np.concatenate([before / RATE_HZ, times + _UNTOUCHED / RATE_HZ])
        mean = values[untouched].mean(axis=0)
        values = np.concatenate([np.repeat(mean[None], _UNTOUCHED, axis=0), values])
    return content.sensor, numbers, times, values, content.emulated


def _numbers(content: Content) -> NDArray[np.int64]:
    """Running numbers (n,) from 0, with the gaps that lost frames left.

    Where a board started anew, the frame follows as if none had been lost.
    """
    steps = np.diff(content.number)
    return np.concatenate([[0], np.cumsum(np.where(steps > 0, steps, 1))])


def _clock(content: Content) -> NDArray[np.float64]:
    """Times (n,) [s] that never go back.

    Where those of the board do, or are no numbers, as when it started anew, the times of reception
    tell how much passed; where these do not either, the frame follows as quickly as most.
    """
    steps, received = np.diff(content.time_s), np.diff(content.received_s)
    steps = np.where(np.isfinite(steps) & (steps >= 0), steps, received)
    sound = np.isfinite(steps) & (steps >= 0)
    usual = float(np.median(steps[sound])) if sound.any() else 1 / RATE_HZ
    return np.concatenate([[0.0], np.cumsum(np.where(sound, steps, usual))])
