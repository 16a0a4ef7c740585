"""Status of a board while it is recorded: rate, noise, lost frames, contacts."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eitbench.hardware.board import Frame
from eitbench.scenarios.recordings.quality import (
    reciprocity_error,
    suspect_electrodes,
    typical_noise,
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

    def status(self, damaged: int) -> Status:
        """The status now, with the number of `damaged` frames that the board has counted."""
        reciprocity, snr_db = float("nan"), float("nan")
        suspects: tuple[int, ...] = ()
        # Frames without numbers say nothing about noise or contacts.
        last = [frame for frame in self._last if np.isfinite(frame.values).all()]
        if last:
            values = np.array([frame.values for frame in last])
            reference = values.mean(axis=0)
            if len(self._pattern.reciprocal_pairs()) and reference.any():
                reciprocity = float(reciprocity_error(reference, self._pattern))
            suspects = suspect_electrodes(values, self._pattern)
            noise = np.sqrt(np.mean(typical_noise(values) ** 2))
            with np.errstate(divide="ignore"):
                snr_db = float(20 * np.log10(np.sqrt(np.mean(reference**2)) / noise))
        return Status(
            self._frames,
            self._rate_hz(),
            snr_db,
            self._dropped,
            damaged,
            reciprocity,
            suspects,
        )

    def _rate_hz(self) -> float:
        if len(self._last) < 2:
            return float("nan")
        seconds = self._last[-1].received_s - self._last[0].received_s
        return (len(self._last) - 1) / seconds if seconds > 0 else float("nan")
