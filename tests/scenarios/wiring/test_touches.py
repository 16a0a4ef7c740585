"""Touches at known places tell the first electrode of a sensor that looks alike from several."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from eitbench.scenarios.arrays import Array
from eitbench.scenarios.physics.forward import forward_model
from eitbench.scenarios.sensors.outlines import Disc
from eitbench.scenarios.sensors.patterns import DrivePattern, offset_pattern
from eitbench.scenarios.sensors.sensor import Sensor, even_electrodes
from eitbench.scenarios.wiring.diagnosis import diagnose
from eitbench.scenarios.wiring.hypotheses import Wiring, meaning, orders
from eitbench.scenarios.wiring.touches import Touches, by_touches

E = 8
PLACES = 0.001 * np.array([[20, 5], [-15, 22], [4, -28], [-25, -9], [12, 25], [-5, 3.0]])


@cache
def disc() -> Sensor:
    outline = Disc(0.04)
    return Sensor(
        name="disc", outline=outline, electrodes=even_electrodes(outline, E, 0.006, 1e-3),
        pattern=offset_pattern(E, 3), background=1.0, image_shape=(32, 32), data_range=1.0,
        conductivity_range=(0.05, 20.0),
    )  # fmt: skip


def measured(numbers: NDArray[np.int64]) -> tuple[Array, Array]:
    """Untouched frame and changes with 60 dB, of a model with twice as many pixels."""
    table = numbers[disc().pattern.table]
    sensor = replace(disc(), pattern=DrivePattern(table), image_shape=(64, 64))
    x, y = sensor.pixel_centres
    images = [np.where(np.hypot(x - a, y - b) < 6e-3, 0.6, 1.0) for a, b in PLACES]
    model = forward_model(sensor)
    frames = model.voltages(np.array([model.background, *images]))
    size = 1e-3 * np.sqrt(np.mean(frames[0] ** 2))
    frames += size * np.random.default_rng(0).normal(size=frames.shape)
    return frames[0], frames[1:] - frames[0]


@pytest.mark.parametrize(("start", "step"), [(0, 1), (3, 1), (6, -1)])
def test_touches_tell_start_and_direction(start: int, step: int) -> None:
    numbers = (start + step * np.arange(E)) % E
    untouched, changes = measured(numbers)
    alone = diagnose(untouched[None], disc())
    assert alone.certainty == "sure but for start and direction"
    found = diagnose(untouched[None], disc(), touches=Touches(-2 * changes, PLACES))
    assert found.certainty == "sure"
    assert (found.wiring.start, found.wiring.step) == (start, step)
    assert found.similarity > 0.9
    assert found.runner_up != found.misfit  # that of another answer


def test_all_answers_that_fit_alike_are_counted_on_a_sensor_of_many_electrodes() -> None:
    many = replace(
        disc(), electrodes=even_electrodes(disc().outline, 40, 0.002, 1e-3),
        pattern=offset_pattern(40, 1),
    )  # fmt: skip
    model = forward_model(many)
    found = diagnose(model.voltages(model.background)[None], many)
    assert found.certainty == "sure but for start and direction"
    assert found.open_answers == 80


@pytest.mark.parametrize(("start", "step"), [(0, 1), (3, 1), (6, -1)])
def test_touches_tell_the_order_alone_where_values_have_reciprocal_ones(
    start: int, step: int
) -> None:
    """As where the untouched frame says nothing: all orders are tried.

    The sense-major one has, row by row, the reciprocals of the declared one, and no touch tells
    them apart.
    """
    numbers = (start + step * np.arange(E)) % E
    _, changes = measured(numbers)
    fitting = [of for of in orders(disc().pattern) if len(of.table) == len(disc().pattern.table)]
    codes = [meaning(of.table, E, magnitudes=False) for of in fitting]
    assert sum(np.array_equal(code, codes[0]) for code in codes) > 1
    told = by_touches(disc(), Touches(changes, PLACES), fitting, magnitudes=False)
    assert told.sure
    assert told.wiring == Wiring(0, start, step)


def test_touches_at_wrong_places_tell_nothing() -> None:
    untouched, changes = measured(np.arange(E))
    noise = np.random.default_rng(1).normal(size=changes.shape) * np.abs(changes).max()
    found = diagnose(untouched[None], disc(), touches=Touches(noise, PLACES))
    assert found.certainty == "sure but for start and direction"
