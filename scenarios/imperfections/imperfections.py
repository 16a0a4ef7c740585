"""Imperfections: differences between a real sensor and its nominal description.

In the order in which they act on a touch:

1. The sensor as built. Electrodes lie off their places along the rim, their widths and contact
   impedances are uneven. (The mesh that data come from belongs here too: no real field is computed
   on the grid of an image.)
2. The material. Its conductivity drifts with temperature, evenly and as a gradient across the
   sensor, and it recovers slowly, so that the last touch is still there in part. Both multiply
   the conductivity, which therefore stays above 0.
3. The board. Every channel (pair of measuring electrodes) has a gain and an offset of its own; a
   value still holds a part of the one measured before it (settling), and mains hum; the converter
   clips and rounds.
4. Faults: electrodes without contact, a channel that saturates, lost frames (the one sent before
   is seen again, even if that was lost), and a reference frame that is old.

What is drawn (standard normal, by the key of a unit and of the quantity) is multiplied with the
declared magnitude, so that the same unit shows the same deviation alone, among all others, and at
any severity.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.declaration import Declaration
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Electrode, Sensor

TOUCH_INTERVAL_S = 10.0
"""Time from one touch of a simulated split to the next, also from session to session [s]."""
FRAME_S = 0.1
"""Time in which a board measures one frame [s]: 10 frames/s."""
MAINS_HZ = 50.0
MAINS_OFF_HZ = 0.02
"""Standard deviation of the grid from `MAINS_HZ` [Hz], which is within 0.05 Hz nearly always (the
standard frequency range of Regulation (EU) 2017/1485, annex III). Without it the hum would be the
same in all frames that are whole periods apart, and differences to a reference would have none."""
HEADROOM = 1.25
"""Full scale of the converter over the greatest value of the untouched sensor; strong touches near
a driving pair go beyond it."""
SATURATION = 0.6  # what a saturated channel reaches of its greatest untouched value
_DRIFT_PERIODS_S = (900.0, 3600.0)  # a room's temperature swings within a quarter to a whole hour
_DRIFT_TERMS = 3
_GRADIENT = 0.5  # drift at the rim against that of the whole
_NARROWEST = 0.3  # an electrode keeps so much of its width, and of its distance to the next
FIRST_TRAINING_UNIT = 10**9
"""Units of training data are numbered from here, so that no other data are of them."""


Magnitude = Annotated[float, Field(ge=0, le=10)]
"""Of an imperfection: relative, or in metres; ten times a whole sensor or frame is none."""
MeshKind = Literal["image", "fine", "unstructured", "slab"]
"""The mesh that data come from, see `Imperfections`."""


_OF_ELECTRODES = {"electrode_shift_m", "electrode_width", "contact_impedance"}
_OF_MATERIAL = {"drift", "relaxation"}


class Imperfections(Declaration):
    """Deviations of sensors and boards of one make; without any, they are ideal.

    Attributes:
        unit: which of many sensors of the same make: decides what is drawn. Of a scenario, the
            first one: every session of touches is on another unit.
        severity: factor of all magnitudes; faults, the mesh and the range of the converter are as
            they are, but at 0 it does not round.
        mesh: "image", the mesh of the image grid, which methods invert with; "fine", one of the
            same kind twice as fine; "unstructured", triangles three times finer than pixels;
            "slab", in three dimensions, with electrodes of half the height (see `slab.SLAB`).
        electrode_shift_m: standard deviation along the rim [m].
        electrode_width: standard deviation relative to the nominal width.
        contact_impedance: standard deviation of its natural logarithm.
        drift: standard deviation over hours of the conductivity, relative.
        relaxation: share of the last touch (of the logarithm of its conductivity) that is left.
        gain: standard deviation of a channel's gain, relative.
        offset: standard deviation of a channel's offset, relative to the rms of a frame.
        settling: share of the value measured before that is left in a value.
        mains: amplitude of the hum, relative to the rms of a frame; its frequency is a little off
            `MAINS_HZ`.
        bits: resolution of the converter, which clips at `HEADROOM`; None for an ideal one.
        dead: electrodes without contact: what they drive or measure reads 0.
        saturated: a channel, numbered in the order of its first measurement, that clips.
        lost_every: one in so many frames is lost, drawn for each, and the one before seen again.
        reference_age_s: age of the reference frames at the first touch of a split [s]; at those of
            a later session they are older by the touches between.
    """

    unit: int = Field(default=0, ge=0, lt=FIRST_TRAINING_UNIT // 2)
    severity: float = Field(default=1.0, ge=0, le=10)
    mesh: MeshKind = "image"
    electrode_shift_m: Magnitude = 0.0
    electrode_width: Magnitude = 0.0
    contact_impedance: Magnitude = 0.0
    drift: Magnitude = 0.0
    relaxation: Annotated[float, Field(ge=0, lt=1)] = 0.0
    gain: Magnitude = 0.0
    offset: Magnitude = 0.0
    settling: Annotated[float, Field(ge=0, lt=1)] = 0.0
    mains: Magnitude = 0.0
    bits: int | None = Field(default=None, ge=4, le=24)
    dead: tuple[Annotated[int, Field(ge=0)], ...] = ()
    saturated: int | None = Field(default=None, ge=0)
    lost_every: int | None = Field(default=None, ge=2)
    reference_age_s: Annotated[float, Field(ge=0, le=1e9)] = TOUCH_INTERVAL_S

    @property
    def drawn(self) -> bool:
        """True if one unit differs from another, or a touch depends on the one before it."""
        names = _OF_ELECTRODES | _OF_MATERIAL | {"gain", "offset", "mains", "lost_every"}
        return any(getattr(self, name) for name in names)

    def of_voltages(self) -> dict[str, object]:
        """What decides voltages before they reach the board; empty without any of it."""
        deciding = {name for name in _OF_ELECTRODES | _OF_MATERIAL if getattr(self, name)}
        if not deciding:
            return {}
        return self.model_dump(include=deciding | {"unit", "severity", "reference_age_s"})

    def built(self, nominal: Sensor) -> tuple[Electrode, ...]:
        """The electrodes of this unit of the sensor `nominal`, none of which overlap."""
        if not any(getattr(self, name) for name in _OF_ELECTRODES):
            return nominal.electrodes
        count = nominal.n_electrodes
        shift = self._drawn("electrode shift", count) * self.electrode_shift_m
        factor = np.exp(self._drawn("electrode width", count) * self.electrode_width)
        contact = np.exp(self._drawn("contact impedance", count) * self.contact_impedance)
        width = np.array([e.width for e in nominal.electrodes])
        room, free = rooms(nominal), farthest_shifts(nominal)
        moved = np.clip(shift, -free, free)
        widest = 2 * (room - np.abs(moved)) * (1 - 1e-6)
        widths = np.clip(width * factor, np.minimum(_NARROWEST * width, widest), widest)
        return tuple(
            Electrode(e.centre + by, to, e.contact_impedance * z)
            for e, by, to, z in zip(
                nominal.electrodes, moved.tolist(), widths.tolist(), contact.tolist(), strict=True
            )
        )

    def drifted(self, sensor: Sensor, time_s: float) -> Array:
        """Factor (H, W) of the conductivity at a time [s] after the first touch of a split."""
        if not self.drift:
            return np.ones(sensor.image_shape)
        even, east, north = (self._wander(axis, time_s) for axis in ("even", "x", "y"))
        x0, y0, x1, y1 = sensor.outline.bounds
        x, y = sensor.pixel_centres
        across = 2 * (x - (x0 + x1) / 2) / (x1 - x0) * east
        along = 2 * (y - (y0 + y1) / 2) / (y1 - y0) * north
        return np.asarray(np.exp(self._scaled(self.drift) * (even + _GRADIENT * (across + along))))

    def _wander(self, axis: str, time_s: float) -> float:
        """A smooth random course of standard deviation 1 at a time [s]."""
        rng = generator("unit", self.unit, "drift", axis)
        periods = rng.uniform(*_DRIFT_PERIODS_S, size=_DRIFT_TERMS)
        phases = rng.uniform(0, 2 * np.pi, size=_DRIFT_TERMS)
        waves = np.sin(2 * np.pi * time_s / periods + phases)
        return float(np.sqrt(2 / _DRIFT_TERMS) * waves.sum())

    def remaining(self, touch: Array, last: Array | None) -> Array:
        """Conductivity (H, W) [S/m] of a `touch` (H, W) after the `last`, given as a ratio (H, W).

        The ratio is that of the last touch to the untouched sensor.
        """
        share = min(self._scaled(self.relaxation), 1.0)
        return touch if last is None or not share else touch * last**share

    def analogue(
        self,
        frames: Array,
        untouched: Array,
        pattern: DrivePattern,
        times_s: Array | None = None,
        frame_s: float = FRAME_S,
    ) -> Array:
        """Return `frames` (n, M) [V/A] as they reach the converter of the board, without noise.

        Of a board that reports magnitudes they act on these, as if it measured without a sign: a
        value near 0 may become negative.

        Args:
            frames: ideal frames.
            untouched: ideal frame (M,) of the untouched sensor, whose rms is the unit of offsets.
            pattern: the drive pattern.
            times_s: (n,) when they are measured [s]; by default `TOUCH_INTERVAL_S` apart.
            frame_s: time in which one is measured [s].
        """
        if times_s is None:
            times_s = np.arange(len(frames)) * np.float64(TOUCH_INTERVAL_S)
        values = frames.copy()
        values[:, np.isin(pattern.table, self.dead).any(axis=1)] = 0.0
        channel, pairs = channels(pattern)
        rms = float(np.sqrt(np.mean(untouched**2)))
        values *= 1 + self._drawn("gain", len(pairs))[channel] * self.gain
        values += min(self._scaled(self.settling), 1.0) * (np.roll(values, 1, axis=1) - values)
        if self.mains:
            measured_at = times_s[:, None] + frame_s * np.arange(len(channel)) / len(channel)
            rng = generator("unit", self.unit, "mains")
            phase = rng.uniform(0, 2 * np.pi)
            frequency = MAINS_HZ + MAINS_OFF_HZ * rng.standard_normal()
            hum = np.sin(2 * np.pi * frequency * measured_at + phase)
            values += self._scaled(self.mains) * rms * hum
        values += self._drawn("offset", len(pairs))[channel] * self.offset * rms
        return np.abs(values) if pattern.magnitudes else values

    def digital(self, frames: Array, untouched: Array, pattern: DrivePattern) -> Array:
        """Return `frames` (n, M), as the converter receives them, as the board sends them."""
        values = frames.copy()
        if self.saturated is not None:
            clipped = channels(pattern)[0] == self.saturated
            limit = SATURATION * np.abs(untouched[clipped]).max(initial=0.0)
            values[:, clipped] = values[:, clipped].clip(-limit, limit)
        if self.bits is not None:
            full_scale = HEADROOM * float(np.abs(untouched).max())
            step = self._scaled(2 * full_scale / 2**self.bits)
            values = values.clip(-full_scale, full_scale)
            if step > 0:
                values = step * np.round(values / step)
        return values

    def received(self, frames: Array, before: Array, first: int = 0) -> Array:
        """The frames (n, M) of one session that arrive: instead of a lost one, the one before it.

        That one is sent again, so that it is seen even if it was lost itself. The first of them has
        the number `first`; `before` (M,) was sent before it.
        """
        if self.lost_every is None:
            return frames
        sent = np.concatenate([before[None], frames])
        drawn = generator("unit", self.unit, "lost").random(first + len(frames))[first:]
        return sent[np.arange(len(frames)) + (drawn >= 1 / self.lost_every)]

    def _scaled(self, magnitude: float) -> float:
        return self.severity * magnitude

    def _drawn(self, what: str, count: int) -> Array:
        """Standard normal values (count,) of this unit times the severity."""
        drawn = generator("unit", self.unit, what).standard_normal(count)
        return np.asarray(self.severity * drawn)


def channels(pattern: DrivePattern) -> tuple[NDArray[np.int64], list[tuple[int, int]]]:
    """Channel of every measurement (M,), and the two electrodes of each, the lower one first.

    There is one for each pair that is measured, numbered in the order in which they first occur.
    """
    measured = [(min(pair), max(pair)) for pair in pattern.table[:, 2:].tolist()]
    pairs = list(dict.fromkeys(measured))
    return np.array([pairs.index(pair) for pair in measured]), pairs


TYPICAL = Imperfections(
    mesh="unstructured",
    electrode_shift_m=0.0005,
    electrode_width=0.05,
    contact_impedance=0.3,
    drift=0.01,
    relaxation=0.05,
    gain=0.01,
    offset=0.002,
    settling=0.002,
    mains=0.0005,
    bits=16,
)
"""A carefully made sensor and board: ours to choose, as nobody publishes these figures together.

The drift is that of repeated presses of a hydrogel skin (`hydrogel-repeats`, 0.9 % of a frame),
electrodes are placed by hand to half a millimetre, and resistors have 1 %.
"""


def rooms(sensor: Sensor) -> Array:
    """Half of the part (E,) of the rim [m] around each electrode that is its own.

    It ends halfway between its end and that of the next electrode.
    """
    perimeter = sensor.outline.perimeter
    centres, width = np.array([(e.centre % perimeter, e.width) for e in sensor.electrodes]).T
    gaps = (centres[:, None] - centres[None, :]) % perimeter
    np.fill_diagonal(gaps, perimeter)
    return np.asarray((np.minimum(gaps, gaps.T) / 2 + (width[:, None] - width) / 4).min(axis=1))


def farthest_shifts(sensor: Sensor) -> Array:
    """The farthest that each electrode (E,) of a unit can be from its nominal place [m]."""
    width = np.array([e.width for e in sensor.electrodes])
    return np.asarray((1 - _NARROWEST) * (rooms(sensor) - width / 2))
