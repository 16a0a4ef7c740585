"""Touches at known places, which tell numbers and order where the untouched sensor cannot.

The change that each touch makes is predicted for every wiring from the model with a soft disc at
its place. For the cosine c of measured and predicted change a touch counts -log(1 - c^2) / 2, as if
one value were measured with normal errors. The best wiring has to be ahead of every other one in
the sum, and by a paired t-test over touches; also of those in which two electrodes are
interchanged, which are not searched otherwise. Wirings that no touch can tell apart, because each
value of one is the reciprocal of the other's, are one: the first is named.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.physics.forward import forward_model, signed_voltages
from eitbench.scenarios.recordings.descriptors import RecordedFrames
from eitbench.scenarios.sensors.sensor import Sensor
from eitbench.scenarios.wiring.evidence import modelled_resistances
from eitbench.scenarios.wiring.hypotheses import (
    Order,
    Table,
    Wiring,
    meaning,
    numberings,
    with_swaps,
)

LEAST, MOST = 5, 50
"""Fewer touches are not looked at; more add nothing."""
AHEAD, AHEAD_T = 0.1, 1.5
"""How far the best wiring has to be ahead of each other one, in the sum over touches and in t of
the paired test. Chosen with draws of 10 presses from 16 recorded skins."""
RADIUS_M, SOFTENING = 8e-3, 0.7
"""Of the touches that are modelled."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Frames of single touches of unknown wiring.

    Attributes:
        changes: (n, M) pressed minus untouched.
        places: (n, 2) x and y [m].
    """

    changes: Array
    places: Array


@dataclass(frozen=True)
class Answer:
    """The wiring that explains touches best.

    Attributes:
        wiring: the best one.
        sure: it is ahead of every other one.
        similarity: mean cosine of measured and predicted change.
    """

    wiring: Wiring
    sure: bool
    similarity: float


def touches_of(recording: RecordedFrames) -> Touches | None:
    """Up to `MOST` single touches of a recording at known places; None if it has not enough."""
    samples = recording.samples
    single = np.zeros(len(samples), dtype=bool)
    if "x_m" in samples:
        single = np.isfinite(samples[["x_m", "y_m"]].to_numpy(dtype=float)).all(axis=1)
    if "contacts" in samples:
        single &= samples["contacts"].to_numpy() == 1
    rows = np.flatnonzero(single)
    if len(rows) < LEAST:
        return None
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST)).astype(int)]
    places = samples[["x_m", "y_m"]].to_numpy(dtype=float)[rows]
    return Touches(recording.voltages[rows] - recording.reference, places)


def by_touches(
    sensor: Sensor,
    touches: Touches,
    candidates: list[Order],
    *,
    magnitudes: bool,
    swapped: tuple[int, ...] = (),
) -> Answer:
    """Find the numbers and the order of `candidates` that explain touches best.

    Args:
        sensor: the nominal one.
        touches: in the order of one of `candidates`.
        candidates: orders of as many values.
        magnitudes: the values have no sign.
        swapped: electrodes that are known to be interchanged.
    """
    resistances = modelled_resistances(sensor)
    changes = np.stack([_pressed(sensor, place) - resistances for place in touches.places])
    e = sensor.n_electrodes
    tried = [Wiring(one.order, one.start, one.step, swapped) for one in numberings(candidates, e)]

    def tables(wirings: list[Wiring]) -> list[Table]:
        return [one.numbers(e)[candidates[one.order].table] for one in wirings]

    def scores(wirings: list[Wiring]) -> tuple[Array, Array]:
        cosines = np.stack(
            [
                _cosines(table, resistances, changes, touches.changes, magnitudes)
                for table in tables(wirings)
            ]
        )
        # All touches change the conductivity in one direction, whichever it is.
        cosines *= np.where(cosines.mean(axis=1, keepdims=True) < 0, -1, 1)
        return -np.log1p(-(np.clip(cosines, 0, 0.999) ** 2)) / 2, cosines

    score, cosines = scores(tried)
    total = score.sum(axis=1)
    codes = meaning(np.stack(tables(tried)), e, magnitudes=magnitudes)
    others = (codes != codes[np.argmax(total)]).any(axis=1)
    best = int(np.argmin(others))
    gain = score[best] - score[others]
    t = gain.mean(axis=1) / (gain.std(axis=1, ddof=1) + 1e-9) * np.sqrt(gain.shape[1])
    sure = bool(((gain.sum(axis=1) >= AHEAD) & (t >= AHEAD_T)).all())
    if sure and not swapped:
        other, _ = scores(list(with_swaps(tried[best], e)))
        sure = bool(other.sum(axis=1).max() <= total[best] + AHEAD)
    return Answer(tried[best], sure, float(cosines[best].mean()))


def _cosines(
    table: Table, resistances: Array, changes: Array, measured: Array, magnitudes: bool
) -> Array:
    """(n,) cosines of `measured` changes (n, M) and those of the model under a `table` (M, 4)."""
    src, sink, a, b = table.T
    expected = changes[:, a, src] - changes[:, b, src] - changes[:, a, sink] + changes[:, b, sink]
    if magnitudes:
        expected = expected * np.sign(signed_voltages(table, resistances))
    size = np.linalg.norm(expected, axis=1) * np.linalg.norm(measured, axis=1)
    product = np.sum(expected * measured, axis=1)
    return np.asarray(np.divide(product, size, out=np.zeros(len(size)), where=size > 0))


def _pressed(sensor: Sensor, place: NDArray[np.float64]) -> Array:
    """(E, E) transfer resistances with a touch at `place` (x, y) [m]."""
    model = forward_model(sensor)
    x, y = sensor.pixel_centres
    distance = np.where(sensor.mask, np.hypot(x - place[0], y - place[1]), np.inf)
    soft = distance <= max(RADIUS_M, float(distance.min()))
    sigma = np.where(soft, SOFTENING, 1.0) * model.background
    _, fields = model.voltages_and_fields(sigma[None])
    return np.asarray(fields[0, len(model.mesh.nodes) :])
