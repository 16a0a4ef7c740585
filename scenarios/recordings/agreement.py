"""Agreement of a recording with the model of its sensor, and with its labels.

Nothing here is fitted to a method: the reference frame is compared with the model's up to a gain,
and each touch with the change that a small touch of one pixel would make (the columns of the
Jacobian), of which the most similar one tells a place and whether the conductivity rose or fell.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.imperfections.faults import SATURATED, dead_electrodes, saturated_values
from eitbench.scenarios.physics.forward import forward_model, signed_voltages
from eitbench.scenarios.recordings.descriptors import LOADS, RecordedFrames, contact_places
from eitbench.scenarios.sensors.sensor import Sensor

LEAST_SPREAD = 0.01
"""Standard deviation of the values of a frame over their rms, below which it is constant. That of a
sensor is far larger (0.6 and more in all public sets, as pairs near the drive see most), that of a
stuck converter is its noise."""


@dataclass(frozen=True)
class Fit:
    """Agreement of a frame with the frame of a model, up to a gain above 0.

    Attributes:
        correlation: cosine of both.
        misfit: norm of what the gain leaves, over the norm of the frame; 1 where no gain helps.
    """

    correlation: float
    misfit: float

    def __str__(self) -> str:
        return f"correlation {self.correlation:.2f}, misfit {self.misfit:.1%} with the best gain"


def fit(frame: Array, modelled: Array) -> Fit:
    """Agreement of `frame` (M,), which is not 0, with that of a model (M,)."""
    cosine = float(frame @ modelled / (np.linalg.norm(frame) * np.linalg.norm(modelled)))
    return Fit(cosine, float(np.sqrt(max(1 - max(cosine, 0.0) ** 2, 0.0))))


def fit_of_sensor(frame: Array, sensor: Sensor) -> Fit:
    """Agreement of the `frame` (M,) of an untouched sensor with the model of `sensor`."""
    model = forward_model(sensor)
    return fit(frame, model.voltages(model.background))


_WHOLE = 0.9
"""Correlation of a frame with that of the untouched sensor, above which it is no difference: those
of touches have up to 0.86 in the public sets, and whole frames 0.92 and more where a model
describes the sensor."""


def differences_problem(differences: Array, sensor: Sensor) -> str:
    """Sentence on `differences` (n, M) that look like whole frames; "" where they do not."""
    touched = differences[differences.any(axis=1)]
    model = forward_model(sensor)
    whole = model.voltages(model.background)
    # Those of a reversed drive, too.
    alike = np.array([abs(fit(frame, whole).correlation) for frame in touched])
    if alike.size and np.mean(alike > _WHOLE) >= ONE_WAY:
        return (
            "The values look like whole frames, not like differences: import them without "
            "--differences."
        )
    return ""


_BAD, _BETTER = 0.1, 0.5
"""Misfit that is looked into, and misfit of another numbering over it that is clearly better."""
_GOOD = 0.3
"""Misfit of a model that describes a sensor: emulated boards and the tanks have 0.03 to 0.25 (and
`jku-tank-adjacent`, which is not reciprocal, 0.39); the hydrogel skins, whose boards no model
describes, 0.67 and more under every numbering, so that it says nothing of them."""


def reference_problem(frame: Array, sensor: Sensor) -> str:
    """What is wrong with the `frame` (M,) of the untouched `sensor`, in a sentence; "" for nothing.

    The electrodes are numbered anew from each electrode and in both directions, and the sign of the
    values is reversed: another one is named if it leaves less than half of the misfit.
    """
    size = float(np.sqrt(np.mean(frame**2)))
    if size == 0 or float(np.std(frame)) < LEAST_SPREAD * size:
        return (
            f"The reference is {'0' if size == 0 else f'about {frame.mean():.3g}'} in all values, "
            "whereas those of an untouched sensor differ: the board did not measure. See whether "
            "it drives current, and take the reference again."
        )
    model = forward_model(sensor)
    _, fields = model.voltages_and_fields(model.background[None])
    resistance = fields[0, len(model.mesh.nodes) :]
    around = np.arange(sensor.n_electrodes)
    found: list[tuple[float, str]] = []
    for sign, turned in ((1, ""), (-1, "the sign of every value is reversed")):
        for step, order in ((1, ""), (-1, "in the other direction")):
            for start in around.tolist():
                number = (start + step * around) % sensor.n_electrodes
                modelled = signed_voltages(sensor.pattern.table, resistance[np.ix_(number, number)])
                if sensor.pattern.magnitudes:
                    modelled = np.abs(modelled)
                renamed = ""
                if start or order:
                    renamed = f"electrode 0 of the board is electrode {start} of the sensor"
                    renamed += f", and the numbers go {order}" if order else ""
                said = " and ".join(part for part in (turned, renamed) if part)
                found.append((fit(frame, sign * modelled).misfit, said))
    own = found[0][0]
    # Of those that agree alike, as on a round sensor, the first one changes least.
    best = min(misfit for misfit, _ in found)
    misfit, said = next(entry for entry in found if entry[0] <= best + 0.01 * own)
    if own > _BAD and misfit <= min(_BETTER * own, _GOOD):
        hint = "swap src and sink (or a and b) in its pattern" if not said.startswith("e") else ""
        mend = " and ".join(
            part for part in (hint, "number its electrodes so" * ("electrode" in said)) if part
        )
        return (
            f"The reference fits the model of sensor {sensor.name!r} badly (misfit {own:.0%}), but "
            f"well (misfit {misfit:.0%}) if {said}: {mend} in the sensor file."
        )
    if own == 1:
        return (
            f"The reference does not fit the model of sensor {sensor.name!r}: their correlation is "
            "not positive, and no method can use it. Check the order and sign of the values."
        )
    return ""


def fault_problems(frame: Array, sensor: Sensor) -> list[str]:
    """Dead electrodes and saturated values of the `frame` (M,) of the untouched `sensor`."""
    model = forward_model(sensor)
    modelled, pattern = model.voltages(model.background), sensor.pattern
    problems = []
    dead = np.flatnonzero(dead_electrodes(frame, modelled, pattern))
    if dead.size:
        problems.append(
            f"What is driven or sensed with electrode {', '.join(map(str, dead))} is about 0: see "
            "to the contact. Methods leave these values out."
        )
    if saturated := int(saturated_values(frame, modelled, pattern).sum()):
        problems.append(
            f"{saturated} of {len(frame)} values of the untouched sensor are more than "
            f"{SATURATED:g} times as large as its model expects beside the others: an amplifier "
            "saturates, or an electrode has no contact. Methods leave these values out."
        )
    return problems


LEAST_TOUCHES = 10
"""Touches that direction and order of labels are judged from: fewer agree by chance."""
_SIMILAR = 0.3
"""Cosine of a touch and the change of a pixel that says something of it: of noise in M values the
most similar pixel has about 3 / sqrt(M), 0.2 for 200."""
ONE_WAY = 0.9
"""Share of touches that change the conductivity one way, against the declared range. Of noise half
do, and of the public sets that may only fall up to 0.5 seem to rise (`hydrogel-fixed`)."""


def touch_problems(recording: RecordedFrames, sensor: Sensor) -> list[str]:
    """What the touches contradict, in sentences: the declared range, the order of the labels.

    `recording` holds touches in the order of time; its reference agrees with the model's.
    """
    change = recording.voltages - recording.reference
    moved = np.linalg.norm(change, axis=1) > 0
    if moved.sum() < LEAST_TOUCHES:
        return []
    samples = recording.samples[moved].reset_index(drop=True)
    size = np.linalg.norm(change[moved], axis=1)
    cosine, places = _most_similar(change[moved] / size[:, None], sensor)
    shown = places if _knows_places(samples) else np.log(size)[:, None]
    known = _labelled(samples)
    problems = [_range_problem(cosine, sensor)]
    if known is not None:
        problems.append(_order_problem(shown, known))
    return [problem for problem in problems if problem]


def _most_similar(change: Array, sensor: Sensor) -> tuple[Array, Array]:
    """Cosine (n,) of each change (n, M) with that of the most similar pixel, and its place [m]."""
    model = forward_model(sensor)
    pixels = model.jacobian(model.background)[:, sensor.mask]
    cosines = change @ (pixels / np.linalg.norm(pixels, axis=0))
    best = np.abs(cosines).argmax(axis=1)
    x, y = (centre[sensor.mask] for centre in sensor.pixel_centres)
    return cosines[np.arange(len(change)), best], np.stack([x[best], y[best]], axis=1)


def _range_problem(cosine: Array, sensor: Sensor) -> str:
    clear = cosine[np.abs(cosine) >= _SIMILAR]
    low, high = sensor.conductivity_range
    if len(clear) < LEAST_TOUCHES:
        return ""
    for counted, bound, room, does in (
        ((clear > 0).sum(), high, high - 1, "raise"),
        ((clear < 0).sum(), low, 1 - low, "lower"),
    ):
        if counted >= ONE_WAY * len(clear) and room <= _NO_ROOM:
            return (
                f"{counted} of {len(clear)} touches {does} the conductivity, and the "
                f"conductivity_range of sensor {sensor.name!r} ends at {bound:g} times the "
                "background, so that methods cannot show these touches: widen it in the sensor "
                "file, or check the sign of the values."
            )
    return ""


_NO_ROOM = 0.05
"""Range of conductivity, over the background, in which no touch can be shown."""


def _knows_places(samples: pd.DataFrame) -> bool:
    places = samples[["x_m", "y_m"]]
    return bool(places.notna().all(axis=None) and (places.nunique() > 1).any())


def _labelled(samples: pd.DataFrame) -> Array | None:
    """Labels (n, k) that differ: places, else the load or depth; None where there are none."""
    if _knows_places(samples):
        # Of several contacts their middle, near which the most similar pixel is.
        return np.asarray(np.nanmean(contact_places(samples), axis=1))
    for name in (*LOADS, "depth_mm"):
        if name in samples and samples[name].notna().all() and samples[name].nunique() > 1:
            return samples[[name]].to_numpy(np.float64)
    return None


_MANY_TOUCHES = 100
_COMPONENTS = 20


def knowledge_of_places(recording: RecordedFrames, sensor: Sensor) -> str:
    """Fact: what the touches' frames tell of their places, by the model and without; "" for few.

    Without the model it is a linear regression on the strongest components of the changes.
    """
    change = recording.voltages - recording.reference
    moved = np.linalg.norm(change, axis=1) > 0
    samples = recording.samples[moved].reset_index(drop=True)
    known = _labelled(samples)
    if moved.sum() < _MANY_TOUCHES or known is None or not _knows_places(samples):
        return ""
    size = np.median(np.abs(change[moved]), axis=0)
    scaled = np.clip(change[moved] / np.where(size > 0, size, np.inf), -5, 5)
    left, strength, _ = np.linalg.svd(scaled - scaled.mean(axis=0), full_matrices=False)
    components = left[:, :_COMPONENTS] * strength[:_COMPONENTS]
    unit = change[moved] / np.linalg.norm(change[moved], axis=1, keepdims=True)
    by_model = explained(_most_similar(unit, sensor)[1], known, 0)
    return (
        f"Of the places of touches the pixel that responds most alike in the model explains "
        f"{max(by_model, 0):.0%}, a linear regression of the frames "
        f"{max(explained(components, known, 0), 0):.0%}."
    )


LAGS = (1, -1, 2, -2)
_EXPLAINED = 8.0
"""Touches times the share of the labels' variance that a lag explains: with fewer, the best of four
lags explains as much by chance in one of some hundred recordings without any information."""


def _order_problem(shown: Array, known: Array) -> str:
    """A lag of the labels against the touches that explains them clearly better than none."""
    own = explained(shown, known, 0)
    lag = max(LAGS, key=lambda k: explained(shown, known, k))
    best = explained(shown, known, lag)
    # Where places repeat, labels one press late are mostly right: what is left counts, too.
    clearly = best >= 2 * own or 1 - best <= (1 - own) / 2
    if not clearly or best * len(known) < _EXPLAINED:
        return ""
    presses = "one press" if abs(lag) == 1 else "two presses"
    return (
        f"The labels seem {presses} too {'late' if lag > 0 else 'early'}: moved by {presses} they "
        f"explain {best:.0%} of the touches' responses, and as they are {max(own, 0):.0%}. Move "
        "them so, and leave out labels that then have no frames."
    )


def explained(shown: Array, known: Array, lag: int) -> float:
    """Share of the variance of `known` (n, k) that is linear in `shown` (n, p), adjusted for p.

    The label `lag` rows later is taken for what is shown: labels one press late have lag 1.
    """
    n = len(known) - abs(lag)
    x, y = (part[start:][:n] for part, start in ((shown, max(-lag, 0)), (known, max(lag, 0))))
    design = np.column_stack([x, np.ones(n)])
    left = y - design @ np.linalg.lstsq(design, y)[0]
    spread = y - y.mean(axis=0)
    if not spread.any() or n <= design.shape[1]:
        return 0.0
    share = np.sum(left**2) / np.sum(spread**2)
    return float(1 - share * (n - 1) / (n - design.shape[1]))
