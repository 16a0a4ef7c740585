"""Wrong wirings of measured frames, of which the right answer is known."""

from dataclasses import dataclass

import numpy as np

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.wiring.diagnosis import Diagnosis
from eitbench.scenarios.wiring.evidence import Completion
from eitbench.scenarios.wiring.hypotheses import Order, Table, Wiring, meaning, orders


@dataclass(frozen=True, eq=False)
class Scrambled:
    """Frames of a board that is wired wrongly, and how.

    Attributes:
        frames: (n, M').
        wiring, order: the truth.
        table: (M', 4) what each value measures, in the sensor's numbers.
        dead: electrode of the sensor without contact; -1 for none.
        reversed_sign, magnitudes: of the values.
    """

    frames: Array
    wiring: Wiring
    order: Order
    table: Table
    dead: int
    reversed_sign: bool
    magnitudes: bool


def scramble(frames: Array, completion: Completion, rng: np.random.Generator) -> Scrambled:
    """Frames (n, M) of a sensor, as a board with a wiring drawn at random sends them.

    A third of them has two electrodes interchanged, another third an electrode without contact.
    Values that were measured are taken as they are; those that interchanged electrodes would
    measure and nobody has come from resistances that explain the frame (`Completion`). Orders are
    drawn of which every value was measured.
    """
    sensor = completion.sensor
    e = sensor.n_electrodes
    have = completion.measured[0] >= 0
    possible = [
        (k, order, start, step)
        for k, order in enumerate(orders(sensor.pattern))
        for step in (1, -1)
        for start in range(e)
        if have[tuple(Wiring(k, start, step).numbers(e)[order.table].T)].all()
    ]
    k, order, start, step = possible[int(rng.integers(len(possible)))]
    kind = int(rng.integers(3))
    swapped = tuple(sorted(rng.choice(e, 2, replace=False).tolist())) if kind == 1 else ()
    wiring = Wiring(k, start, step, swapped)
    table = wiring.numbers(e)[order.table]
    magnitudes = sensor.pattern.magnitudes or bool(rng.random() < 0.2)
    values = np.stack([completion.values(frame, table) for frame in frames])
    dead = int(rng.choice(np.unique(table))) if kind == 2 else -1
    values *= 10 ** rng.uniform(-2, 2)
    if dead >= 0:
        silent = (table == dead).any(axis=1)
        values[:, silent] *= rng.normal(0, 1e-3, (len(values), int(silent.sum())))
    turned = not magnitudes and bool(rng.random() < 0.5)
    values = np.abs(values) if magnitudes else -values if turned else values
    return Scrambled(values, wiring, order, table, dead, turned, magnitudes)


def put_right(found: Diagnosis, truth: Scrambled, resistances: Array) -> bool:
    """True if the diagnosis is the truth: what each value measures, signs and faults.

    Where start and direction are open, a rotation or reflection that changes the `resistances`
    (E, E) of the sensor by less than 2 % may lie between both.
    """
    e = len(resistances)
    around = np.arange(e)
    maps = [around]
    if found.certainty == "sure but for start and direction":
        centred = resistances - resistances.mean(axis=0) - resistances.mean(axis=1)[:, None]
        centred = centred + resistances.mean()
        turns = [(start + step * around) % e for step in (1, -1) for start in range(e)]
        size = 0.02 * np.linalg.norm(centred)
        maps = [t for t in turns if np.linalg.norm(centred[np.ix_(t, t)] - centred) < size]
    sign = -1 if truth.reversed_sign else 1
    table = truth.table if sign > 0 else truth.table[:, [0, 1, 3, 2]]
    for of in maps:
        same = np.array_equal(
            meaning(of[found.pattern.table], e, magnitudes=truth.magnitudes),
            meaning(table, e, magnitudes=truth.magnitudes),
        )
        dead = () if truth.dead < 0 else (truth.dead,)
        signed = truth.magnitudes or _first_sign(of[found.pattern.table]) == _first_sign(table)
        if same and signed and tuple(sorted(of[list(found.dead)].tolist())) == dead:
            return True
    return False


def _first_sign(table: Table) -> bool:
    src, sink, a, b = table[0].tolist()
    return bool((src > sink) ^ (a > b))
