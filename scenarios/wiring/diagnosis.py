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
from eitbench.scenarios.imperfections.faults import (
    SILENT,
    dead_electrodes,
    never_alone,
    saturated_values,
)
from eitbench.scenarios.recordings.frames import impossible
from eitbench.scenarios.recordings.quality import typical_noise
from eitbench.scenarios.sensors.patterns import DrivePattern
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.wiring.evidence import all_values, modelled_resistances
from eitbench.scenarios.wiring.hypotheses import (
    Order,
    Table,
    Wiring,
    meaning,
    numberings,
    numbers_of,
    orders,
    with_swaps,
)
from eitbench.scenarios.wiring.touches import Touches, by_touches

MARGIN = 1.25
"""Misfit of every other answer over that of the best one, from which it is sure."""
EXPLAINED = 0.5
"""Misfit above which no wiring explains the frames."""
SWAP_GAIN = 1.25
"""Misfit without over that with two electrodes interchanged, below which none are."""
_SILENT = 0.02
"""Size of a value over the upper quartile's, below which it says nothing of the order: an electrode
without contact has it."""
_FAR = 10.0
"""Size of a value over that of the largest tenth, above which an amplifier saturates."""
_EXACT = 0.02
"""Misfit of a model that no real sensor reaches: what differs by less is the mesh."""
_RIVALS = 100
"""Other answers that are looked at for the best one that is not the same with other numbers."""
_TURNED = 40
"""Answers with interchanged electrodes, the best ones, that are tried from every electrode."""
_DISTINCT = 150
"""Answers, the best ones, of which those that mean the same are found."""
_WORK = 400_000
"""Values that are predicted for hypotheses with interchanged electrodes."""

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
        measured, modelled: (M,) the mean frame, and the prediction times the gain.
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
    size = _size(frame)
    magnitudes = bool((frame > -1e-3 * size).all())
    search = _Search(frame, fitting, expected, magnitudes)
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
    rest = search.not_turned(best, far[:_RIVALS]) if turned else found[1:2]
    table = search.table(best.wiring)
    signed = expected[tuple(table.T)]
    sign = best.sign
    clear = np.abs(signed) >= _SILENT * _size(signed)
    if magnitudes and not sensor.pattern.magnitudes and np.ptp(np.sign(signed[clear])) == 0:
        # All have one sign, so that signed values explain the frame as well.
        magnitudes, sign = False, int(np.sign(signed[clear][0]))
    predicted = np.abs(signed) if magnitudes else signed * sign
    pattern = DrivePattern(_with_sign(table, sign, magnitudes), magnitudes)
    # A saturated value would make all electrodes but its own look dead.
    _, huge = _mute_and_far(frame, fitting[best.wiring.order].table)
    tame = np.where(huge, _size(frame) / _size(predicted) * predicted, frame)
    dead = dead_electrodes(tame, predicted, pattern)
    spoiled = np.asarray(saturated_values(tame, predicted, pattern) | huge | _at_a_rail(values))
    kept = ~spoiled & ~dead[pattern.table].any(axis=1)
    gain, leak = _gain_and_leak(frame, predicted, pattern, modelled_resistances(sensor), kept)
    noise = typical_noise(values)
    third = max(len(values) // 3, 1)
    drift = np.linalg.norm(values[-third:].mean(axis=0) - values[:third].mean(axis=0))
    declared = search.misfit_of(sensor.pattern.table) if sensor.n_measurements == length else np.nan
    noisy = float(np.sqrt(np.mean(noise**2)))
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
    all, and without noise where others have some.
    """
    still = np.ptp(values, axis=0) == 0
    if len(values) < 2 or np.count_nonzero(still) > len(still) / 2:
        return np.zeros(len(still), dtype=np.bool_)
    cut = np.zeros(len(still), dtype=np.bool_)
    for end in (values.max(), values.min()):
        at_end = still & (values[0] == end)
        if np.count_nonzero(at_end) > 1:
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
    if not _size(values) > 0:
        raise InputError(
            "Most values of the frames are 0: see whether the board drives current, and record "
            "the untouched sensor again."
        )
    return values


def _size(values: Array) -> float:
    """Upper quartile of sizes: one dead electrode of eight silences half of the values."""
    return float(np.quantile(np.abs(values), 0.75))


@dataclass(frozen=True)
class _Found:
    wiring: Wiring
    misfit: float
    sign: int


class _Search:
    """Hypotheses against one frame (M,)."""

    def __init__(
        self, frame: Array, candidates: list[Order], expected: Array, magnitudes: bool
    ) -> None:
        self._orders, self._expected, self._magnitudes = candidates, expected, magnitudes
        self._e = len(expected)
        self._tables = np.stack([order.table for order in candidates])
        self._frame = frame
        loud = np.abs(frame) >= _SILENT * _size(frame)
        unread = np.stack([_mute_and_far(frame, table) for table in self._tables])
        self._mute = unread[:, 0]
        self._kept = loud & ~unread.any(axis=1)
        self._shown = _unit(np.broadcast_to(frame, self._kept.shape), magnitudes, self._kept)

    def table(self, wiring: Wiring) -> Table:
        """(M, 4) in the sensor's numbers."""
        return np.asarray(wiring.numbers(self._e)[self._orders[wiring.order].table])

    def misfit_of(self, table: Table) -> float:
        """Misfit of a table (M, 4) with its own sign."""
        kept = np.abs(self._frame) >= _SILENT * _size(self._frame)
        return self._misfit(self._expected[tuple(table.T)], kept)

    def explains_silence(self, of: _Found) -> bool:
        """True if the electrode that was left out as silent is silent beside this answer, too."""
        mute, kept = self._mute[of.wiring.order], self._kept[of.wiring.order]
        expected = self._expected[tuple(self.table(of.wiring).T)]
        size, wanted = self._frame**2, expected**2
        silent = size[mute].sum() * wanted[kept].sum() < (
            SILENT**2 * wanted[mute].sum() * size[kept].sum()
        )
        return bool(silent or not mute.any() or self._misfit(expected, kept | mute) <= EXPLAINED)

    def _misfit(self, expected: Array, kept: NDArray[np.bool_]) -> float:
        cosine = _unit(expected, self._magnitudes, kept) @ _unit(
            self._frame, self._magnitudes, kept
        )
        return float(np.sqrt(max(1 - max(float(cosine), 0.0) ** 2, 0.0)))

    def scored(self, wirings: list[Wiring]) -> list[_Found]:
        """The misfits of `wirings`, with the sign that fits."""
        found: list[_Found] = []
        step = max(1, 2_000_000 // self._kept.shape[1])
        for first in range(0, len(wirings), step):
            part = wirings[first : first + step]
            numbers = numbers_of(part, self._e)
            of = np.array([wiring.order for wiring in part])
            tables = numbers[np.arange(len(part))[:, None, None], self._tables[of]]
            predicted = self._expected[tuple(np.moveaxis(tables, -1, 0))]
            predicted = _unit(predicted, self._magnitudes, self._kept[of])
            cosine = np.einsum("nm,nm->n", predicted, self._shown[of])
            # Of magnitudes that fall where the prediction rises, no sign makes an answer.
            size = np.maximum(cosine, 0) if self._magnitudes else np.abs(cosine)
            # Rounded: of answers that mean the same the first one is kept.
            misfit = np.round(np.sqrt(np.maximum(1 - size**2, 0)), 6)
            sign = np.where(self._magnitudes | (cosine >= 0), 1, -1)
            found += map(_Found, part, misfit.tolist(), sign.tolist())
        return found

    def ranked(self) -> list[_Found]:
        """The answers that differ, the best first; without interchanged electrodes if that fits."""
        plain = self._distinct(self.scored(list(numberings(self._orders, self._e))))
        pairs = self._e * (self._e - 1) // 2
        looked_at = max(3, _WORK // (pairs * self._kept.shape[1]))
        swapped: list[_Found] = []
        for of in plain[:looked_at]:
            swapped += self.scored(list(with_swaps(of.wiring, self._e)))
        swapped.sort(key=lambda of: of.misfit)
        # The few that were looked at need not begin at the right electrode.
        kinds = dict.fromkeys((of.wiring.order, of.wiring.swapped) for of in swapped[:_TURNED])
        swapped = self.scored([
            Wiring(order, start, step, pair)
            for order, pair in kinds
            for step in (1, -1)
            for start in range(self._e)
        ])  # fmt: skip
        swapped.sort(key=lambda of: of.misfit)
        if not swapped or plain[0].misfit < SWAP_GAIN * swapped[0].misfit:
            return plain
        return self._distinct(sorted([*plain, *swapped[:_DISTINCT]], key=lambda of: of.misfit))

    def not_turned(self, best: _Found, others: list[_Found]) -> list[_Found]:
        """Those of `others` whose frame is not that of `best` with other numbers around the rim."""
        around = [
            Wiring(0, start, step).numbers(self._e) for step in (1, -1) for start in range(self._e)
        ]
        turned = set(self._meant(np.stack([turn[self.table(best.wiring)] for turn in around])))
        if not others:
            return []
        meant = self._meant(np.stack([self.table(of.wiring) for of in others]))
        return [of for of, code in zip(others, meant, strict=True) if code not in turned]

    def _meant(self, tables: Table) -> list[bytes]:
        """What tables (n, M, 4) mean: equal for those that no linear sensor tells apart."""
        codes = meaning(tables, self._e, magnitudes=self._magnitudes)
        return [code.tobytes() for code in codes]

    def _distinct(self, found: list[_Found]) -> list[_Found]:
        found = sorted(found, key=lambda of: of.misfit)[:_DISTINCT]
        seen: dict[bytes, _Found] = {}
        tables = np.stack([self.table(of.wiring) for of in found])
        for of, code in zip(found, self._meant(tables), strict=True):
            seen.setdefault(code, of)
        return list(seen.values())


def _mute_and_far(frame: Array, table: Table) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Values (M,) of the quietest electrode, if that is silent, and values too large to be real.

    Args:
        frame: (M,).
        table: (M, 4) an order, in the board's numbers. In a wrong one hardly any electrode has all
            the values that a dead one silences.
    """
    size = np.abs(frame)
    of = (table == np.unique(table)[:, None, None]).any(axis=2)
    loudness = np.array([_size(size[rows]) for rows in of])
    quietest = int(np.argmin(loudness))
    mute = of[quietest] & bool(loudness[quietest] < SILENT * np.median(loudness))
    return mute, size > _FAR * np.quantile(size[~mute], 0.9)


def _unit(values: Array, magnitudes: bool, kept: NDArray[np.bool_]) -> Array:
    """Roots of values (..., M) of norm 1, of magnitudes without their mean; 0 if not `kept`."""
    roots = np.where(kept, np.sqrt(np.abs(values)), 0)
    if magnitudes:
        mean = roots.sum(axis=-1, keepdims=True) / np.maximum(kept.sum(axis=-1, keepdims=True), 1)
        roots = np.where(kept, roots - mean, 0)
    else:
        roots = np.sign(values) * roots
    size = np.linalg.norm(roots, axis=-1, keepdims=True)
    return np.asarray(roots / np.where(size > 0, size, 1))


def _verdict(
    best: _Found, close: list[_Found], others: list[_Found], sensor: Sensor
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
