"""Latency of touch detection: from a touch to a live image that shows it, and what stays after it.

A stream of frames of an emulated sensor passes the live pipeline: reference frame, method, rule of
contacts. A frame k is measured from k T to (k + 1) T; its values are measured one after the other,
so that a touch with onset at phase p of frame k changes only those measured later. A touch is

- detected by the first live image whose strongest contact lies within a distance of its place;
- gone with the first live image after its release that shows no contact at all.

Frames are counted from the one in which the touch begins (or ends), as if each became an image: a
figure of method and sensor, not of a machine. Times are those of the live view: an image is shown
one computing time after its frame was complete, and frames that arrive meanwhile are dropped but
for the newest (`imaging.LatestValue`). Time on the wire and in the browser is not included.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import numpy as np
import pandas as pd

from eitbench.hardware.board import Frame
from eitbench.hardware.emulation.emulated_sensor import EmulatedSensor, Touch
from eitbench.hardware.live.imaging import (
    REFERENCE_FRAMES,
    ImageMaker,
    reference_of,
    use_one_thread,
)
from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.imperfections import FRAME_S, TYPICAL
from eitbench.scenarios.phantoms.press import PRESSURE_PA
from eitbench.scenarios.progress import with_bar
from eitbench.scenarios.seeds import generator
from eitbench.scenarios.sensors.sensor import Sensor

PRESSURES_PA = (PRESSURE_PA[0], 1e4, PRESSURE_PA[1])
"""Light, medium and firm [Pa]."""
UNTOUCHED = 10
"""Frames before the one in which the touch begins."""
HOLD_S, AFTER_S = 2.0, 2.0
"""Time of a touch, and time that is measured after it [s]."""
RADIUS, DISTANCE = 0.05, 0.1
"""Radius of a touch, and the distance within which it is detected, over the shorter side."""
REPEATS = 20
_TRIES = 1000


@dataclass(frozen=True)
class Press:
    """A touch in a stream.

    Attributes:
        x_m, y_m, radius_m: its place and radius [m].
        onset, release: when it begins and ends [frames]; the fraction is the phase in the frame.
        busy: how much of an image is still to be computed when the first frame arrives, 0 to 1.
    """

    x_m: float
    y_m: float
    radius_m: float
    onset: float
    release: float
    busy: float = 0.0

    def course(
        self, number: int, pressure_pa: float, frame_s: float
    ) -> list[tuple[float, list[Touch]]]:
        """The course of the touch during a frame, as `EmulatedSensor.scan` takes it."""
        there = [Touch(self.x_m, self.y_m, self.radius_m, pressure_pa)]
        first = there if self.onset <= number < self.release else []
        changes: list[tuple[float, list[Touch]]] = [(self.onset, there), (self.release, [])]
        within = [(at * frame_s, touches) for at, touches in changes if number < at < number + 1]
        return [(number * frame_s, first), *within]


def draw_press(sensor: Sensor, radius_m: float, frame_s: float, seed: int, number: int) -> Press:
    """Draw place and phases of touch `number`, evenly over the sensor and over a frame.

    Raises:
        InputError: the sensor has no room for it.
    """
    rng = generator("latency", seed, number)
    x0, y0, x1, y1 = sensor.outline.bounds
    rim = sensor.outline.point(np.linspace(0, sensor.outline.perimeter, 1000))
    for _ in range(_TRIES):
        x, y = rng.uniform((x0, y0), (x1, y1)).tolist()
        if sensor.outline.contains(x, y) and np.hypot(*(rim - (x, y)).T).min() >= radius_m:
            begin, end, busy = rng.uniform(size=3).tolist()
            held = max(3, round(HOLD_S / frame_s))
            return Press(x, y, radius_m, UNTOUCHED + begin, UNTOUCHED + held + end, busy)
    raise InputError(
        f"The sensor {sensor.name!r} has no room for a touch of radius {1e3 * radius_m:.3g} mm: "
        "give a smaller one, for example `--radius 1`."
    )


def stream(
    emulated: EmulatedSensor, press: Press, pressure_pa: float, frame_s: float
) -> tuple[list[Array], list[Frame]]:
    """Return frames (M,) for the reference, as old as the unit declares, and those of the touch."""
    begin_s = -emulated.imperfections.reference_age_s - REFERENCE_FRAMES * frame_s
    times = (begin_s + k * frame_s for k in range(REFERENCE_FRAMES))
    reference = [emulated.scan(time_s, frame_s, [(time_s, [])]) for time_s in times]
    count = int(press.release) + 1 + max(3, round(AFTER_S / frame_s))
    frames = [
        Frame(
            k, k * frame_s, (k + 1) * frame_s,
            emulated.scan(k * frame_s, frame_s, press.course(k, pressure_pa, frame_s)),
        )
        for k in range(count)
    ]  # fmt: skip
    return reference, frames


def shown(received_s: Sequence[float], image_s: float, free_s: float = 0.0) -> dict[int, float]:
    """Numbers of the frames that become an image, and when each image is shown [s].

    Args:
        received_s: when frames arrive [s], in order.
        image_s: computing time of an image [s].
        free_s: when the first image can be begun [s].
    """
    at: dict[int, float] = {}
    k = 0
    while k < len(received_s):
        start = max(free_s, received_s[k])
        k = int(np.searchsorted(received_s, start, side="right")) - 1  # the newest
        at[k] = free_s = start + image_s
        k += 1
    return at


def image_course(
    maker: ImageMaker, frames: Sequence[Frame], press: Press, distance_m: float
) -> pd.DataFrame:
    """What the live images of all frames show, one row a frame.

    Returns:
        `contacts` (their number), `hit` (the strongest lies within the distance [m] of the place),
        `strength` (mean fall of conductivity within it over the median of that of frames wholly
        measured during the touch; NaN without an image), `failed`.
    """
    x, y = maker.sensor.pixel_centres
    near = maker.sensor.mask & (np.hypot(x - press.x_m, y - press.y_m) <= distance_m)
    rows = []
    for frame in frames:
        live = maker.live_image(frame)
        hit = bool(live.contacts) and bool(
            np.hypot(live.contacts[0].x_m - press.x_m, live.contacts[0].y_m - press.y_m)
            <= distance_m
        )
        fall = np.nan if live.image is None else maker.sensor.background - live.image[near].mean()
        rows.append({
            "contacts": len(live.contacts), "hit": hit, "strength": float(fall),
            "failed": bool(live.failed),
        })  # fmt: skip
    course = pd.DataFrame(rows)
    held = course["strength"].iloc[int(press.onset) + 1 : int(press.release)]
    course["strength"] /= held.median()
    return course


def latency_of(
    course: pd.DataFrame, press: Press, frame_s: float, at: dict[int, float]
) -> dict[str, float]:
    """The figures of one touch from its `image_course`, and when each image is shown [s].

    Returns:
        `detected_frames`, `detected_ms`: inf if it is not detected before its release.
        `gone_frames`, `gone_ms`: inf if contacts stay; NaN for a touch that no frame detected.
        `ghost`: 1 if a frame measured wholly after the release shows it, else 0; NaN as above.
        `ghost_strength`: strength in the first of these; NaN as above.
        `untouched`, `false_contacts`: frames before the touch, and those of them with a contact.
        `dropped`, `failed`: share of frames without image, and of those that the method fails on.
    """
    first, last = int(press.onset), int(press.release)
    numbers = np.arange(len(course))
    hit, clear = course["hit"].to_numpy(), course["contacts"].to_numpy() == 0
    seen = (numbers >= first) & (numbers <= last) & hit
    gone = (numbers >= last) & clear
    noticed = bool(seen.any())

    def frames(found: Array, since: int) -> float:
        return float(np.argmax(found) - since + 1) if found.any() else np.inf

    def ms(found: Array, since: float) -> float:
        times = (time_s for k, time_s in at.items() if found[k])
        return 1e3 * (next(times, np.inf) - since * frame_s)

    return {
        "detected_frames": frames(seen, first),
        "detected_ms": ms(seen, press.onset),
        "gone_frames": frames(gone, last) if noticed else np.nan,
        "gone_ms": ms(gone, press.release) if noticed else np.nan,
        "ghost": float(hit[last + 1 :].any()) if noticed else np.nan,
        "ghost_strength": course["strength"][last + 1] if noticed else np.nan,
        "untouched": first,
        "false_contacts": int((~clear[:first]).sum()),
        "dropped": 1 - len(at) / len(course),
        "failed": float(course["failed"].mean()),
    }


@dataclass(frozen=True, eq=False)
class Latencies:
    """Latencies of methods on one sensor.

    Attributes:
        radius_m, distance_m: radius of the touches, and the distance that counts as detected [m].
        image_ms: computing time of an image of each method [ms].
        touches: one row for each method, material (ideal or not), pressure and touch, with
            the figures of `latency_of`.
        images: one row a live image that is shown, with the time it is shown after onset and
            release of the touch [s], and the figures of `image_course`.
    """

    radius_m: float
    distance_m: float
    image_ms: dict[str, float]
    touches: pd.DataFrame
    images: pd.DataFrame


def measure(
    sensor: Sensor,
    methods: Sequence[str],
    snr_db: float | None,
    *,
    frame_rate: float = 1 / FRAME_S,
    touches: int = 20,
    radius_m: float | None = None,
    reference_age_s: float = TYPICAL.reference_age_s,
    seed: int = 0,
    image_ms: float | None = None,
    show: bool = False,
) -> Latencies:
    """Measure the latency of `methods` on `sensor`.

    Each touch is on a unit of its own and comes with every pressure, in a material that drifts and
    relaxes and in one that does neither.

    Args:
        sensor: the nominal sensor.
        methods: names of methods that can be used live.
        snr_db: SNR of a frame [dB]; inf is no noise.
        frame_rate: frames/s.
        touches: number of places and phases.
        radius_m: of the touch [m]; by default `RADIUS` of the sensor's shorter side.
        reference_age_s: age of the reference before the first frame [s].
        seed: of places, phases and units.
        image_ms: computing time of an image [ms]; by default it is measured, for each method.
        show: show a bar of progress.

    Raises:
        InputError: an SNR that is not given, a frame rate or radius that is not above 0, an age
            below 0, no room for the touch, a method that is unknown or cannot be used live.
    """
    side = sensor.outline.shorter_side
    radius_m = RADIUS * side if radius_m is None else radius_m
    if snr_db is None or np.isnan(snr_db):
        raise InputError(
            "When a touch is detected depends on the noise: give the SNR of a frame in dB, for "
            "example `--snr 60`."
        )
    for what, value, unit in (
        ("frame rate", frame_rate, "frames/s"),
        ("radius of a touch", 1e3 * radius_m, "mm"),
    ):
        if not 0 < value < np.inf:
            raise InputError(f"The {what} has to be above 0, got {value:g} {unit}.")
    if not 0 <= reference_age_s < np.inf:
        raise InputError(f"The age of a reference is at least 0 s, got {reference_age_s:g}.")
    frame_s, distance_m = 1 / frame_rate, DISTANCE * side
    presses = [draw_press(sensor, radius_m, frame_s, seed, k) for k in range(touches)]
    makers = {name: ImageMaker(sensor) for name in methods}
    for name, maker in makers.items():
        maker.check(name)
    rows: list[dict[str, object]] = []
    images: list[pd.DataFrame] = []
    times: dict[str, float] = {}
    with use_one_thread():
        for name, maker in makers.items():
            maker.fit(name)
        for k, press in enumerate(with_bar(presses, "Touches", touches, show=show)):
            new = EmulatedSensor(sensor, _unit(seed, k), snr_db)
            age = {"reference_age_s": reference_age_s}
            new.imperfections = new.imperfections.model_copy(update=age)
            for about, reference, frames in _streams(new, press, frame_s):
                for name, maker in makers.items():
                    maker.reference = reference_of(sensor, reference)
                    if name not in times:
                        held = frames[int(press.release) - 1]
                        times[name] = _image_ms(maker, held) if image_ms is None else image_ms
                    course = image_course(maker, frames, press, distance_m)
                    of: dict[str, Any] = {"method": name, **about, "touch": k}
                    image_s = times[name] / 1e3
                    received = [frame.received_s for frame in frames]
                    at = shown(received, image_s, received[0] + press.busy * image_s)
                    rows.append(of | asdict(press) | latency_of(course, press, frame_s, at))
                    image, time_s = course.loc[list(at)], np.array(list(at.values()))
                    images.append(
                        image.assign(
                            after_onset_s=time_s - press.onset * frame_s,
                            after_release_s=time_s - press.release * frame_s,
                            **of,
                        )
                    )
    return Latencies(
        radius_m, distance_m, times, pd.DataFrame(rows), pd.concat(images, ignore_index=True)
    )


def _unit(seed: int, number: int) -> int:
    """Return the unit of the sensor that touch `number` is on."""
    return int(generator("latency unit", seed, number).integers(2**31))


def _streams(
    new: EmulatedSensor, press: Press, frame_s: float
) -> Iterator[tuple[dict[str, float], list[Array], list[Frame]]]:
    """Streams of one touch on one unit, which is as new for each: pressure and material differ."""
    for ideal in (True, False):
        for pressure_pa in reversed(PRESSURES_PA):  # firm first: its images take the longest
            emulated = copy(new)
            if ideal:
                emulated.imperfections = new.imperfections.model_copy(
                    update={"drift": 0.0, "relaxation": 0.0}
                )
            about = {"ideal": ideal, "pressure_kpa": pressure_pa / 1e3}
            yield about, *stream(emulated, press, pressure_pa, frame_s)


def _image_ms(maker: ImageMaker, frame: Frame) -> float:
    """Median computing time of a live image [ms]; the first, which takes longer, does not count."""
    maker.live_image(frame)
    return median(maker.live_image(frame).image_ms for _ in range(REPEATS))
