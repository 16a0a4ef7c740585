"""The doctor: which wiring explains frames of an untouched sensor, and how sure that is.

Frames are compared by the roots of their values, which keeps their sign and lets small values
count. The misfit of a hypothesis is sqrt(1 - c^2), c the cosine of both (of magnitudes: the
correlation, as all are positive). Of hypotheses that every linear sensor answers alike
(`hypotheses.meaning`) one is kept. An answer is sure if every other one has `MARGIN` times its
misfit; where those that do not differ from it only in first electrode and direction, the untouched
sensor cannot tell these (a round one looks the same from each electrode), and the rest is sure.
What it cannot tell, touches at known places may (`touches`).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.errors import InputError
from eitbench.scenarios.imperfections.faults import dead_electrodes, never_alone, saturated_values
from eitbench.scenarios.recordings.frames import impossible
from eitbench.scenarios.recordings.quality import frame_noise, typical_noise
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.wiring.evidence import all_values, modelled_resistances
from eitbench.scenarios.wiring.hypotheses import Order, Table, Wiring, orders
from eitbench.scenarios.wiring.search import EXPLAINED, SMALL, Found, Search, mute_and_far, size_of
from eitbench.scenarios.wiring.touches import Touches, by_touches

MARGIN = 1.25
"""Misfit of every other answer over that of the best one, from which it is sure."""
_EXACT = 0.02
"""Misfit of a model that no real sensor reaches: what differs by less is the mesh."""
_RIVALS = 100
"""Other answers that are looked at for the best one that is not the same with other numbers."""

Certainty = Literal["sure", "sure but for start and direction", "refused"]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the frames say of the wiring, and of themselves.

    Attributes:
        certainty: how sure the answer is.
        reason: why it is refused, or what is open, in a sentence; "" where it is sure.
        wiring: the best answer.
        order: of the values, in the board's numbers.
        pattern: what each value measures, in the sensor's numbers; where the start is open, with
            the declared one if it fits as well.
        reversed_sign: every value has the other sign than in `order`.
        misfit, runner_up: of the best answer and of the best other one (that differs in more than
            start and direction where these are open).
        declared_misfit: of the sensor as declared; NaN where it has another number of values.
        gain: of the frame over the prediction, above 0.
        leak: share of the common-mode voltage of both measuring electrodes in the values; NaN of
            magnitudes.
        dead: electrodes without contact, in the sensor's numbers; as few as explain the silence.
        never_alone: electrodes that drive and sense only together with a dead one, so that nothing
            says whether they have contact.
        saturated: indices of saturated values: far too large, or several at one end of the range.
        measured, modelled: (M,) the median frame (of two the mean), and the prediction times the
            gain.
        noise: (M,) standard deviation from frame to frame; NaN for one frame.
        snr_db: rms of the frame over that of the noise [dB].
        drift: change from the first to the last third of the frames, over the frame's norm.
        repeatability: median of noise over size of the values.
        open_answers: how many answers fit alike.
        similarity: mean cosine of touches and what the model predicts; NaN where none were needed.
    """

    certainty: Certainty
    reason: str
    wiring: Wiring
    order: Order
    pattern: DrivePattern
    reversed_sign: bool
    misfit: float
    runner_up: float
    declared_misfit: float
    gain: float
    leak: float
    dead: tuple[int, ...]
    never_alone: tuple[int, ...]
    saturated: tuple[int, ...]
    measured: Array
    modelled: Array
    noise: Array
    snr_db: float
    drift: float
    repeatability: float
    open_answers: int
    similarity: float


def diagnose(
    frames: Array, sensor: Sensor, expected: Array | None = None, touches: Touches | None = None
) -> Diagnosis:
    """Find how `frames` (n, M') of the untouched `sensor` were wired.

    Args:
        frames: in the order of time; M' may differ from the sensor's number of values.
        sensor: the nominal one.
        expected: (E, E, E, E) the value of every row src, sink, a, b on this sensor, such as
            `Completion.all_values` of a frame of the right wiring; by default the model's.
        touches: in the order of `frames`, which decide where the untouched sensor cannot tell.

    Raises:
        InputError: frames of a length that no order has, that are no numbers, or all about 0.
    """
    values = _checked(frames)
    known = orders(sensor.pattern)
    length = values.shape[1]
    fitting = [order for order in known if len(order.table) == length]
    if not fitting:
        lengths = sorted({len(order.table) for order in known})
        raise InputError(
            f"The frames have {length} values, and orders of sensor {sensor.name!r} have "
            f"{', '.join(map(str, lengths))}: name the sensor whose pattern the board measures."
        )
    known_frame = expected is not None
    if expected is None:
        expected = all_values(modelled_resistances(sensor))
    frame = np.median(values, axis=0) if len(values) > 2 else values.mean(axis=0)
    size = size_of(frame)
    magnitudes = bool((frame > -1e-3 * size).all())
    search = Search(frame, fitting, expected, magnitudes)
    found = search.ranked()
    best = found[0]
    limit = MARGIN * max(best.misfit, 0.0 if known_frame else _EXACT)
    close = [of for of in found[1:] if of.misfit < limit]
    others = search.not_turned(best, close)
    certainty, reason = _verdict(best, close, others, sensor)
    if certainty != "refused" and not search.explains_silence(best):
        certainty = "refused"
        reason = (
            "One electrode of the board is silent, and the wiring that fits best does not explain "
            "it: give frames of this sensor from when its wiring was right (--known)."
        )
    similarity = float("nan")
    if touches is not None and certainty != "sure":
        among = fitting if certainty == "refused" else [fitting[best.wiring.order]]
        told = by_touches(
            sensor, touches, among, magnitudes=magnitudes,
            swapped=() if certainty == "refused" else best.wiring.swapped,
        )  # fmt: skip
        similarity = told.similarity
        if told.sure:
            order = told.wiring.order if certainty == "refused" else best.wiring.order
            (best,) = search.scored([replace(told.wiring, order=order)])
            certainty, reason, close = "sure", "", []
    if certainty == "sure but for start and direction":
        # What changes least.
        best = min((best, *close), key=lambda of: (of.wiring.step < 0, of.wiring.start, of.misfit))
    turned = certainty == "sure but for start and direction"
    far = [of for of in found if of is not best and of not in close]
    other = [of for of in found if of.wiring != best.wiring]
    rest = search.not_turned(best, far[:_RIVALS]) if turned else other[:1]
    table = search.table(best.wiring)
    signed = expected[tuple(table.T)]
    sign = best.sign
    clear = np.abs(signed) >= SMALL * size_of(signed)
    if magnitudes and not sensor.pattern.magnitudes and np.ptp(np.sign(signed[clear])) == 0:
        # All have one sign, so that signed values explain the frame as well.
        magnitudes, sign = False, int(np.sign(signed[clear][0]))
    predicted = np.abs(signed) if magnitudes else signed * sign
    pattern = DrivePattern(_with_sign(table, sign, magnitudes), magnitudes)
    # A saturated value would make all electrodes but its own look dead.
    _, huge = mute_and_far(frame, fitting[best.wiring.order].table)
    tame = np.where(huge, size_of(frame) / size_of(predicted) * predicted, frame)
    dead = dead_electrodes(tame, predicted, pattern)
    spoiled = np.asarray(saturated_values(tame, predicted, pattern) | huge | _at_a_rail(values))
    kept = ~spoiled & ~dead[pattern.table].any(axis=1)
    gain, leak = _gain_and_leak(frame, predicted, pattern, modelled_resistances(sensor), kept)
    noise = typical_noise(values)
    third = max(len(values) // 3, 1)
    drift = np.linalg.norm(values[-third:].mean(axis=0) - values[:third].mean(axis=0))
    declared = search.misfit_of(sensor.pattern.table) if sensor.n_measurements == length else np.nan
    noisy = frame_noise(values)
    rms = float(np.sqrt(np.mean(frame**2)))
    return Diagnosis(
        certainty=certainty,
        reason=reason,
        wiring=best.wiring,
        order=fitting[best.wiring.order],
        pattern=pattern,
        reversed_sign=sign < 0,
        misfit=best.misfit,
        runner_up=rest[0].misfit if rest else 1.0,
        declared_misfit=declared,
        gain=gain,
        leak=leak,
        dead=tuple(np.flatnonzero(dead).tolist()),
        never_alone=tuple(np.flatnonzero(never_alone(dead, pattern)).tolist()),
        saturated=tuple(np.flatnonzero(spoiled).tolist()),
        measured=frame,
        modelled=gain * predicted,
        noise=noise,
        snr_db=float(20 * np.log10(rms / noisy)) if noisy > 0 else float("nan" if noisy else "inf"),
        drift=float(drift / np.linalg.norm(frame)),
        repeatability=float(np.median(noise / np.maximum(np.abs(frame), 1e-9 * size))),
        open_answers=len(close) + 1,
        similarity=similarity,
    )


def declared_frame(found: Diagnosis, sensor: Sensor, expected: Array | None) -> Array | None:
    """(M,) what `sensor` as declared predicts for frames of `found`, with the gain that fits best.

    None where it has another number of values.
    """
    if sensor.n_measurements != len(found.measured):
        return None
    if expected is None:
        expected = all_values(modelled_resistances(sensor))
    frame = expected[tuple(sensor.pattern.table.T)]
    frame = np.abs(frame) if found.pattern.magnitudes else frame
    size = np.linalg.norm(found.measured) / np.linalg.norm(frame)
    return np.asarray(size * frame)


def _at_a_rail(values: Array) -> NDArray[np.bool_]:
    """Values (M,) that stand at the same end of the range in all of several frames (n, M).

    A board cuts what is too large for it: several values are then equal, the largest or least of
    all, and without noise where others have some. At 0 stand those of an electrode without contact.
    """
    still = np.ptp(values, axis=0) == 0
    if len(values) < 2 or np.count_nonzero(still) > len(still) / 2:
        return np.zeros(len(still), dtype=np.bool_)
    cut = np.zeros(len(still), dtype=np.bool_)
    for end in (values.max(), values.min()):
        at_end = still & (values[0] == end)
        if end != 0 and np.count_nonzero(at_end) > 1:
            cut |= at_end
    return cut


def _checked(frames: Array) -> Array:
    values = np.asarray(frames, dtype=np.float64)
    if values.ndim != 2 or not len(values):
        raise InputError(
            f"The doctor needs frames as rows (n, M) of numbers, got shape {values.shape}."
        )
    if (bad := impossible(values)).size:
        raise InputError(
            f"Frame {bad[0]} holds a value that is no number or that no board can measure: leave "
            "this frame out."
        )
    if not size_of(values) > 0:
        raise InputError(
            "Most values of the frames are 0: see whether the board drives current, and record "
            "the untouched sensor again."
        )
    return values


def _verdict(
    best: Found, close: list[Found], others: list[Found], sensor: Sensor
) -> tuple[Certainty, str]:
    if best.misfit > EXPLAINED:
        return "refused", (
            f"No wiring explains the frames: the best one leaves {best.misfit:.0%}. Check outline, "
            f"electrodes and pattern of sensor {sensor.name!r}, or give frames of this sensor from "
            "when its wiring was right (--known)."
        )
    if others:
        return "refused", (
            f"{len(close) + 1} wirings fit alike (misfit {best.misfit:.1%} and "
            f"{others[0].misfit:.1%}): record more frames of the untouched sensor, or give frames "
            "from when its wiring was right (--known)."
        )
    if close:
        return "sure but for start and direction", (
            f"{len(close) + 1} first electrodes and directions fit alike, as the untouched sensor "
            "looks the same from each; all else is sure. Disconnect two electrodes that you know "
            "in turn and see which number is dead, or give frames from when its wiring was right "
            "(--known)."
        )
    return "sure", ""


def _with_sign(table: Table, sign: int, magnitudes: bool) -> Table:
    return table if sign > 0 or magnitudes else table[:, [0, 1, 3, 2]]


def _gain_and_leak(
    frame: Array, expected: Array, pattern: DrivePattern, r: Array, kept: NDArray[np.bool_]
) -> tuple[float, float]:
    """Gain, and share of the common-mode voltage of a and b, by least squares."""
    x = expected[kept]
    if pattern.magnitudes or not kept.any():
        gain = float(np.median(np.abs(frame[kept]) / np.maximum(np.abs(x), 1e-12)))
        return gain, float("nan")
    src, sink, a, b = pattern.table[kept].T
    balanced = r - r.mean(axis=0)  # voltages have the mean of the electrodes as their zero
    common = (balanced[a, src] + balanced[b, src] - balanced[a, sink] - balanced[b, sink]) / 2
    gain, leak = np.linalg.lstsq(np.stack([x, common], axis=1), frame[kept])[0].tolist()
    return abs(gain), leak / gain if gain else float("nan")
